"""Evaluate policies on fixed goals."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from marl_mm.envs.registry import make_task
from marl_mm.eval.cross_play import CrossPlay
from marl_mm.eval.evaluate import Evaluation, Setup
from marl_mm.eval.robustness import Robustness
from marl_mm.files import refuse_existing, write_json
from marl_mm.policy import Policy
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.policies import load_policy, own_engine, own_task
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.sim.config import Engine, engine_overrides
from marl_mm.versions import versions


def evaluate(
    policy: Any,
    *,
    episodes: int = 100,
    seed: int = 0,
    task: str | None = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    workers: int = 1,
    config: Any = None,
    progress: Bar = silent_bar,
    **settings: Any,
) -> Evaluation:
    """Evaluate a policy on a seed's goals.

    They are half ahead and half behind where the task does not draw its own.

    Args:
        policy: Run, run folder, checkpoint file, ``pretrained``, a collector's name, or
            a policy.
        episodes: Number of goals.
        seed: Seed of the goals and of random policies.
        task: Registered name of the task; default the run's own, or Reach-v0.
        max_steps: Steps per episode; default the task's.
        engine: Engine of the simulation, bullet or mujoco; default the run's own.
        workers: Processes; the result does not depend on their number.
        config: Settings of a collector's policy; default the collector's.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        **settings: Settings of a collector's policy, by name.

    Raises:
        UsageError: If a setting makes no sense, or there is no such policy.
        CheckpointError: If a run's checkpoint is damaged.
    """
    goals = episodes, seed, task, max_steps, engine, workers
    setup = setup_of([policy], *goals)
    actor = load_policy(policy, setup.made, config, **settings)
    name = called(policy, actor)
    advance = progress(f"eval {Path(name).name}", episodes)
    with setup.rollouts() as rollouts:
        return replace(setup.run(rollouts, actor, advance), policy=name)


def setup_of(
    policies: Sequence[Any],
    episodes: int,
    seed: int,
    task: str | None,
    max_steps: int | None,
    engine: Engine | None,
    workers: int,
) -> Setup:
    """Task and goals of evaluations, by default those of the runs among policies.

    Raises:
        UsageError: If a setting makes no sense, or runs are of several tasks or
            engines.
    """
    check_positive(episodes=episodes, workers=workers)
    check_seed(seed)
    overrides = task_overrides(max_steps, engine or own_engine(policies))
    name = own_task(policies) if task is None else task
    return Setup(name, overrides, int(episodes), int(seed), int(workers))


def called(source: Any, policy: Policy) -> str:
    """Name of a policy in tables: its source's, or its own if it is the source."""
    return policy.name if source is policy else str(getattr(source, "folder", source))


Evaluated = Evaluation | Robustness | CrossPlay
"""A result of evaluations."""


def evaluations_json(evaluations: Sequence[Evaluated]) -> list[dict[str, Any]]:
    """Evaluations with the versions of the packages that made them."""
    return [each.to_json() | {"packages": versions()} for each in evaluations]


def save_evaluations(
    evaluations: Sequence[Evaluated], path: str | Path, overwrite: bool = False
) -> None:
    """Write evaluations to a JSON file, with a row per episode.

    Raises:
        OutputExistsError: If the file exists, unless ``overwrite``.
    """
    refuse_existing(Path(path), overwrite, file=True)
    write_json(Path(path), evaluations_json(evaluations))


def task_overrides(
    max_steps: int | None, engine: Engine | None = None
) -> dict[str, Any]:
    """Settings of a task that are replaced: steps of an episode and engine, if any.

    Raises:
        UsageError: If the steps are not positive, or there is no such engine.
    """
    overrides = engine_overrides(engine)
    make_task(overrides=overrides)  # raises
    if max_steps is None:
        return overrides
    check_positive(max_steps=max_steps)
    return {"max_steps": int(max_steps), **overrides}
