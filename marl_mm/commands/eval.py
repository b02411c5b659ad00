"""marl-mm eval: policies side by side on the same goals."""

from pathlib import Path

import tyro

from marl_mm.commands.options import CORES, CollectorsSettings, OwnTask, config_of
from marl_mm.commands.output import print_evaluations, show
from marl_mm.commands.parser import command
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bars
from marl_mm.runs.evaluate import (
    evaluate,
    evaluations_json,
    save_evaluations,
    task_overrides,
)
from marl_mm.runs.policies import (
    load_policy,
    own_engine,
    own_task,
    policy_names,
)
from marl_mm.sim.config import Engine


@command
def main(
    policies: tyro.conf.Positional[tuple[str, ...]],
    *,
    episodes: int = 100,
    seed: int = 0,
    task: OwnTask = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    workers: int = CORES,
    out: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
    settings: CollectorsSettings,
) -> None:
    """Evaluate runs and scripted policies on fixed goals.

    Args:
        policies: Run folders, checkpoint files, "pretrained" or names of collectors.
        episodes: Number of goals: half ahead and half behind, where the task does not
            draw its own.
        seed: Seed of the goals and of random policies.
        task: Registered name of the task.
        max_steps: Steps per episode; default the task's.
        engine: Engine of the simulation; default the runs' own, or bullet, or
            mujoco without PyBullet.
        workers: Processes; the result does not depend on their number.
        out: JSON file to write everything to, with a row per episode.
        overwrite: Replace OUT if it exists.
        json: Print everything, with one row per episode, as JSON.
        settings: Settings of collectors' policies.
    """
    if not policies:
        raise UsageError(
            f"no policy given, expected run folders or {', '.join(policy_names())}"
        )
    if out is not None:
        refuse_existing(out, overwrite)
    task = own_task(policies) if task is None else task
    engine = own_engine(policies) if engine is None else engine
    variant = make_task(task, task_overrides(max_steps, engine))
    for name in policies:  # before any work is done
        load_policy(name, variant, config_of(name, settings))
    with progress_bars() as bar:
        evaluations = [
            evaluate(
                name,
                episodes=episodes,
                seed=seed,
                task=task,
                max_steps=max_steps,
                engine=engine,
                workers=workers,
                config=config_of(name, settings),
                progress=bar,
            )
            for name in policies
        ]
    if out is not None:
        save_evaluations(evaluations, out, overwrite)
    if json:
        show(evaluations_json(evaluations))
    else:
        print_evaluations(evaluations)
