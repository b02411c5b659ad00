"""Evaluate policies under disturbances, and with agents of each other."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.eval import cross_play as crossing
from marl_mm.eval import robustness as disturbing
from marl_mm.eval.cross_play import CrossPlay
from marl_mm.eval.robustness import Robustness
from marl_mm.eval.suite import ROBUSTNESS
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.evaluate import called, setup_of
from marl_mm.runs.policies import load_policy
from marl_mm.sim.config import Engine


def forget(result: object) -> None:
    """Keep nothing of what is finished."""


def robustness(
    policy: Any,
    *,
    disturbances: Sequence[str] | str = tuple(ROBUSTNESS),
    episodes: int = 100,
    seed: int = 0,
    task: str | None = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    workers: int = 1,
    config: Any = None,
    spread: Sequence[float] | None = None,
    progress: Bar = silent_bar,
    keep: Callable[[Robustness], None] = forget,
    **settings: Any,
) -> Robustness:
    """Evaluate a policy under disturbances, on the same goals as without them.

    Args:
        policy: Run, run folder, checkpoint file, ``pretrained``, a collector's name, or
            a policy.
        disturbances: Names of the disturbances, of ``marl_mm.eval.suite.ROBUSTNESS``.
        episodes: Number of goals of each strength of each disturbance.
        seed: Seed of the goals, of random policies and of the disturbances.
        task: Registered name of the task; default the run's own, or Reach-v0.
        max_steps: Steps per episode; default the task's.
        engine: Engine of the simulation, bullet or mujoco; default the run's own.
        workers: Processes; the result does not depend on their number.
        config: Settings of a collector's policy; default the collector's.
        spread: Numbers that noise of strength 1 has as standard deviations, shape (n,),
            in the units of the joint state; default those of the policy's clean run. To
            compare policies give all the same, say of a dataset's states.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        keep: Callback after each condition, with what is finished.
        **settings: Settings of a collector's policy, by name.

    Raises:
        UsageError: If a setting makes no sense, or there is no such policy.
        CheckpointError: If a run's checkpoint is damaged.
    """
    names = [disturbances] if isinstance(disturbances, str) else disturbances
    if not isinstance(names, Sequence):
        raise UsageError(f"`disturbances` is {names!r:.60}, expected names")
    goals = episodes, seed, task, max_steps, engine, workers
    setup = setup_of([policy], *goals)
    actor = load_policy(policy, setup.made, config, **settings)
    name = called(policy, actor)
    units = None if spread is None else _spread(spread, len(setup.made.layout.state))
    for result in disturbing.robustness(setup, actor, name, progress, names, units):
        keep(result)
    return result


def _spread(values: Sequence[float], entries: int) -> np.ndarray:
    try:
        spread = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        spread = np.empty(0)
    if spread.shape != (entries,) or not (np.isfinite(spread) & (spread >= 0)).all():
        raise UsageError(
            f"`spread` is {values!r:.60}, expected {entries} numbers >= 0, one for "
            "each entry of the joint state"
        )
    return spread


def cross_play(
    policies: Sequence[Any],
    *,
    configs: Sequence[Any] | None = None,
    episodes: int = 100,
    seed: int = 0,
    task: str | None = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    workers: int = 1,
    progress: Bar = silent_bar,
    keep: Callable[[CrossPlay], None] = forget,
) -> CrossPlay:
    """Evaluate teams of which one agent is that of another run, for all pairs of runs.

    Args:
        policies: Runs and others as in ``evaluate``, of the same task, two at least.
        configs: Settings of each, as ``config`` there; default their own.
        episodes: Number of goals of each team.
        seed: Seed of the goals and of random policies.
        task: Registered name of the task; default the runs' own, or Reach-v0.
        max_steps: Steps per episode; default the task's.
        engine: Engine of the simulation, bullet or mujoco; default the runs' own.
        workers: Processes; the result does not depend on their number.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        keep: Callback after each team, with what is finished.

    Raises:
        UsageError: If a setting makes no sense, or runs are of several tasks.
        LayoutError: If a run is made for another layout than the task has.
        CheckpointError: If a run's checkpoint is damaged.
    """
    if not isinstance(policies, Iterable) or isinstance(policies, str):
        raise UsageError(f"{policies!r:.80} are no policies, expected 2 or more")
    policies = list(policies)
    if len(policies) < 2:
        raise UsageError(f"cross-play of {len(policies)} policy, expected 2 or more")
    setup = setup_of(policies, episodes, seed, task, max_steps, engine, workers)
    if not isinstance(configs, Sequence | None):
        raise UsageError(f"`configs` is {configs!r:.40}, expected a list of settings")
    settings = configs or [None] * len(policies)
    if len(settings) != len(policies):
        raise UsageError(
            f"`configs` are {len(settings)}, expected {len(policies)}, one of a policy"
        )
    actors = [
        load_policy(policy, setup.made, config)
        for policy, config in zip(policies, settings, strict=True)
    ]
    names = [called(*pair) for pair in zip(policies, actors, strict=True)]
    for result in crossing.cross_play(setup, actors, names, progress):
        keep(result)
    return result
