"""Offline to online: a run from a dataset goes on with episodes of its own.

Any offline algorithm goes on with its own update. Its batches mix steps of the dataset
with its own in a set ratio (Ball 2023). How many steps it takes to be good again, and
what that costs, is in its rows: ``online/dip``, ``online/regret``,
``online/steps_to_95`` and ``online/kept``.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from marl_mm.algorithms.algorithm import FineTunable
from marl_mm.algorithms.checkpoint import BEST, FILE, save_seed, save_seeds_policy
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.loggers import DEFAULT_LOGGERS, Row
from marl_mm.algorithms.online import RunEpisodes, of_episodes
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import RunLog, is_best
from marl_mm.algorithms.speed import small_networks
from marl_mm.algorithms.train import (
    Evaluate,
    refuse_divergence,
    rows_by_seed,
    update_to,
)
from marl_mm.datasets.arrays import arrays_of
from marl_mm.episode import Episode
from marl_mm.errors import DivergedError
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.progress import Advance, silent

GOOD = 0.95
"""Success rate that ``online/steps_to_95`` is about."""


@small_networks()
def fine_tune(
    algorithm: FineTunable,
    run: Path,
    settings: FineTuning,
    run_episodes: RunEpisodes,
    evaluate: Evaluate,
    advance: Advance = silent,
    stop_diverging: bool = True,
    loggers: Sequence[str] = DEFAULT_LOGGERS,
) -> None:
    """Go on until there are so many own env steps, from wherever the run stands.

    Args:
        algorithm: Of one seed, trained or resumed.
        run: The run's folder, with the rows of its updates.
        settings: Number of steps, ratio of data and updates.
        run_episodes: Runner of training episodes; episode i must not depend on how many
            are run together.
        evaluate: Evaluation of a policy.
        advance: Progress callback, called with env steps.
        stop_diverging: Whether a metric beyond its bound stops the run, too.
        loggers: Names of the loggers beside ``metrics.jsonl``, see ``LOGGERS``.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying which checkpoint there is.
        DivergedError: If a logged metric is not finite or beyond its bound; the last
            checkpoint is left as it is.
        CheckpointError: If the rows are damaged, or end before the checkpoint.
        UsageError: If a logger is unknown or cannot start.
    """
    saved = algorithm.own[1]
    advance(min(saved, settings.online_steps), "")
    with RunLog(run, "step", algorithm.step, loggers) as log:
        try:
            if not any("env_steps" in row for row in log.rows):
                begun = {"step": algorithm.step, "env_steps": 0}
                log.add(begun | _point(algorithm, evaluate))
            while saved < settings.online_steps:
                end = (saved // settings.online_every + 1) * settings.online_every
                end = min(end, settings.online_steps)
                row = _epoch(
                    algorithm, settings, run_episodes, end, advance, stop_diverging
                )
                row |= _point(algorithm, evaluate)
                row |= online_summary([*log.rows, row]) | {"online/kept": settings.kept}
                with deaf_to_interrupts():
                    if is_best(row, log.rows):
                        save_seeds_policy(run / BEST, algorithm, 0)
                    log.add(row)
                    save_seed(run / FILE, algorithm, 0)
                saved = algorithm.own[1]
        except (KeyboardInterrupt, DivergedError) as error:
            where = f"{run}: the checkpoint of env step {saved}"
            if isinstance(error, DivergedError):
                raise DivergedError(f"{error}; {where}") from None
            again = "go on with `resume=True`"
            raise KeyboardInterrupt(f"stopped; {where}; {again}") from None


def _epoch(
    algorithm: FineTunable,
    settings: FineTuning,
    run_episodes: RunEpisodes,
    end: int,
    advance: Advance,
    stop_diverging: bool,
) -> Row:
    """Episodes up to own env step ``end``, the updates between them, and their row."""
    episodes: list[Episode] = []
    metrics: list[Row] = []
    policy = LearnedPolicy(algorithm.name, algorithm.agents(0), algorithm.layout)
    own_episodes, own_steps = algorithm.own
    while own_steps < end:
        explorer = Explorer(policy, settings.online_noise, 0.0)
        numbers = range(own_episodes, own_episodes + settings.online_cycle)
        cycle = list(run_episodes(explorer, numbers))
        algorithm.observe(arrays_of(cycle, "own"), settings.kept)
        episodes += cycle
        before = own_steps
        own_episodes, own_steps = algorithm.own
        steps = own_steps - before
        measured = update_to(
            algorithm, algorithm.step + settings.updates_per_step * steps
        )
        measured |= algorithm.diagnose()
        refuse_divergence(algorithm, measured, stop_diverging)
        metrics += rows_by_seed(algorithm, measured)
        policy = LearnedPolicy(algorithm.name, algorithm.agents(0), algorithm.layout)
        advance(steps, f"reached {100 * np.mean([e.success for e in episodes]):.0f} %")
    names = dict.fromkeys(name for row in metrics for name in row)
    values = {  # a cycle of one update may leave the actors alone
        name: float(np.mean([row[name] for row in metrics if name in row]))
        for name in names
    }
    return {
        "step": algorithm.step,
        "env_steps": own_steps,
        "episodes": own_episodes,
        **of_episodes(episodes),
        **values,
    }


def _point(algorithm: FineTunable, evaluate: Evaluate) -> Row:
    policy = LearnedPolicy(algorithm.name, algorithm.agents(0), algorithm.layout)
    return dict(evaluate(policy))


def online_summary(rows: Sequence[Row]) -> Row:
    """Summary of a run's evaluations online so far.

    Returns:
        ``online/dip``: largest loss of success since the first; ``online/regret``: mean
        share of goals missed; ``online/steps_to_95``: own env steps at the first
        evaluation from which on all reach 95 %, absent if the last does not.
    """
    online = [row for row in rows if "env_steps" in row]
    success = [row["success/all"] for row in online]
    worse = [n for n, rate in enumerate(success) if rate < GOOD]
    good = [row["env_steps"] for row in online[worse[-1] + 1 if worse else 0 :]]
    return {
        "online/dip": max(0.0, success[0] - min(success)),
        "online/regret": 1 - float(np.mean(success)),
        **({"online/steps_to_95": good[0]} if good else {}),
    }
