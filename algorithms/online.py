"""The loop of online learning: run episodes, learn from them, evaluate, keep.

It fills a run folder as ``marl_mm.algorithms.train`` does, and keeps the best policy
beside the last one in ``best.pt``.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from marl_mm.algorithms.algorithm import Resumable
from marl_mm.algorithms.checkpoint import BEST, FILE, checkpoint, policy_checkpoint
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.loggers import DEFAULT_LOGGERS, Row
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import CurvePoint, RunLog, is_best
from marl_mm.algorithms.schedule import Schedule
from marl_mm.algorithms.speed import small_networks
from marl_mm.algorithms.train import Evaluate
from marl_mm.episode import Episode
from marl_mm.errors import DivergedError
from marl_mm.files import write_bytes
from marl_mm.progress import Advance, silent

BeginEvaluation = Callable[[LearnedPolicy], Future[CurvePoint]]
"""Begins an evaluation of a policy, in a thread and environments of its own."""

RunEpisodes = Callable[[Explorer, Iterable[int]], Iterator[Episode]]
"""Runs training episodes of these numbers; the loop knows nothing of environments."""

LEARNT = 0.5
"""Success rate above which a run can be flat: below, learning may not have begun."""


class OnlineConfig(Protocol):
    """Hyper-parameters, a frozen dataclass."""

    @property
    def episodes(self) -> int:
        """Episodes in all."""

    @property
    def episodes_per_cycle(self) -> int:
        """Episodes between updates."""

    @property
    def updates_per_episode(self) -> int:
        """Gradient steps per episode."""


class OnlineAlgorithm(Resumable, Protocol):
    """An algorithm that learns from episodes as they come."""

    episodes: int
    """Number of episodes shown so far."""

    env_steps: int
    """Number of steps in them."""

    updates: int
    """Number of gradient steps."""

    @property
    def config(self) -> OnlineConfig:
        """Hyper-parameters."""

    @property
    def warm(self) -> bool:
        """Whether there is enough experience to learn from."""

    def behaviour(self) -> Explorer:
        """Policy of the next episodes."""

    def observe(self, episode: Episode) -> None:
        """Add an episode to the experience."""

    def learn(self, updates: int) -> dict[str, float]:
        """Many updates; their mean losses."""

    def diagnose(self) -> dict[str, float]:
        """Metrics of actors and critic now."""


@small_networks()
def train_online(
    algorithm: OnlineAlgorithm,
    run: Path,
    run_episodes: RunEpisodes,
    evaluate: Evaluate,
    schedule: Schedule,
    advance: Advance = silent,
    loggers: Sequence[str] = DEFAULT_LOGGERS,
    begin: BeginEvaluation | None = None,
) -> None:
    """Train until the config's number of episodes, or until the success rate is flat.

    Args:
        algorithm: Fresh, or resumed by ``marl_mm.algorithms.train.resume``.
        run: The run's folder.
        run_episodes: Runner of training episodes; episode i must not depend on how many
            are run together.
        evaluate: Evaluation of a policy: ``success/all``, ``return/all`` and more.
        schedule: Times of checkpoints and evaluations.
        advance: Progress callback, called with episodes.
        loggers: Names of the loggers beside ``metrics.jsonl``, see ``LOGGERS``.
        begin: Function that starts an evaluation, which runs during the next epoch; row
            and checkpoint are written when it ends. None: evaluations run between
            epochs.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying which checkpoint there is.
        DivergedError: If a loss is not finite; the checkpoint of the last whole epoch
            is kept.
        CheckpointError: If the rows are damaged, or end before the checkpoint.
        UsageError: If a logger is unknown or cannot start.
    """
    total = algorithm.config.episodes
    advance(algorithm.episodes, "")
    with RunLog(run, "episode", algorithm.episodes, loggers) as log:
        waiting: list[_PendingEpoch] = []
        end = saved = algorithm.episodes

        def keep() -> None:
            nonlocal saved
            while waiting:
                epoch = waiting.pop()
                epoch.keep(log)
                saved = epoch.row["episode"]
                advance(0, _note(log.rows, algorithm.updates))

        try:
            while end < total and not is_flat(log.rows, schedule.patience):
                end = min((end // schedule.epoch + 1) * schedule.epoch, total)
                row = _epoch(algorithm, run_episodes, end, advance)
                keep()
                number = end // schedule.epoch
                due = number % schedule.evaluate_every == 0 or end == total
                worst = [*log.rows, {**row, "success/all": 0.0}]
                last = end == total or is_flat(worst, schedule.patience)
                policy = LearnedPolicy(
                    algorithm.name, deepcopy(algorithm.agents), algorithm.layout
                )
                evaluated: Callable[[], CurvePoint] = CurvePoint
                if due and begin is not None and not last:
                    evaluated = begin(policy).result
                elif due:
                    evaluated = partial(evaluate, policy)
                files = policy_checkpoint(algorithm), checkpoint(algorithm)
                waiting.append(_PendingEpoch(row, evaluated, *files))
                if last or not due or begin is None:
                    keep()
        except KeyboardInterrupt:
            kept = f"{run} holds the checkpoint of episode {saved}: go on"
            where = kept if saved else "before the first checkpoint: start again"
            raise KeyboardInterrupt(f"stopped; {where} with `resume=True`") from None
        except DivergedError as error:
            keep()
            kept = f"the checkpoint of episode {saved}" if saved else "no checkpoint"
            raise DivergedError(f"{error}; {run} holds {kept}") from None


@dataclass(frozen=True)
class _PendingEpoch:
    """Row and files of an epoch, to be written once its evaluation has ended."""

    row: Row
    """Metrics of its episodes and updates."""

    evaluation: Callable[[], CurvePoint]
    """Function that waits for the evaluation; empty if none is due."""

    policy: memoryview
    """File of the policy."""

    checkpoint: memoryview
    """File of the checkpoint."""

    def keep(self, log: RunLog) -> None:
        """Write row and checkpoint, and the policy if it is the best so far."""
        row = self.row | self.evaluation()
        if is_best(row, log.rows):
            write_bytes(log.run / BEST, self.policy)
        log.add(row)
        write_bytes(log.run / FILE, self.checkpoint)


def run_cycle(
    algorithm: OnlineAlgorithm,
    run_episodes: RunEpisodes,
    end: int,
    advance: Advance = silent,
) -> tuple[list[Episode], dict[str, float]]:
    """Episodes of one policy, up to number ``end`` at most, and the updates after them.

    Returns:
        The episodes, and the updates' mean losses: none before the warm-up is over.

    Raises:
        DivergedError: If a loss is not finite.
    """
    config = algorithm.config
    first = algorithm.episodes
    numbers = range(first, min(first + config.episodes_per_cycle, end))
    episodes = []
    for episode in run_episodes(algorithm.behaviour(), numbers):
        algorithm.observe(episode)
        episodes.append(episode)
        advance(1, "")
    if not algorithm.warm:
        return episodes, {}
    losses = algorithm.learn(len(episodes) * config.updates_per_episode)
    for key, value in losses.items():
        if not np.isfinite(value):
            raise DivergedError(
                f"{key} is {value} after {algorithm.updates} updates: lower the "
                "learning rates"
            )
    return episodes, losses


def _epoch(
    algorithm: OnlineAlgorithm, run_episodes: RunEpisodes, end: int, advance: Advance
) -> Row:
    """Episodes up to number ``end``, with the updates between them; its metrics."""
    episodes: list[Episode] = []
    losses: list[dict[str, float]] = []
    while algorithm.episodes < end:
        more, loss = run_cycle(algorithm, run_episodes, end, advance)
        episodes += more
        losses += [loss] if loss else []
    return {
        "episode": end,
        "env_steps": algorithm.env_steps,
        "updates": algorithm.updates,
        **of_episodes(episodes),
        **{key: _mean([row[key] for row in losses]) for key in (losses or [{}])[0]},
        **(algorithm.diagnose() if losses else {}),
    }


def of_episodes(episodes: Sequence[Episode]) -> Row:
    """Means over training episodes, for a row of metrics."""
    return {
        "train/return": _mean([episode.episode_return for episode in episodes]),
        "train/success": _mean([episode.success for episode in episodes]),
        "train/steps": _mean([len(episode) for episode in episodes]),
        **_alpha(episodes),
    }


def _alpha(episodes: Sequence[Episode]) -> dict[str, float]:
    """Mean alpha, where the layout has it."""
    names = episodes[0].layout.action_names
    if "alpha" not in names:
        return {}
    place = names.index("alpha")
    return {"train/alpha": _mean([e.actions[:, place].mean() for e in episodes])}


def is_flat(rows: Sequence[Row], patience: int) -> bool:
    """Whether the success rate has not risen for ``patience`` episodes."""
    measured = [row for row in rows if "success/all" in row]
    if not measured or not patience:
        return False
    best = max(measured, key=lambda row: (row["success/all"], -row["episode"]))
    waited = measured[-1]["episode"] - best["episode"]
    return bool(best["success/all"] > LEARNT and waited >= patience)


def _note(rows: Sequence[Row], updates: int) -> str:
    evaluated = [row["success/all"] for row in rows if "success/all" in row]
    note = "" if updates else "no update yet, "
    note += f"reached {100 * rows[-1]['train/success']:.0f} %"
    return note + (f", eval {100 * evaluated[-1]:.0f} %" if evaluated else "")


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
