"""marl-mm eval: policies side by side on the same goals."""

from functools import partial
from pathlib import Path
from typing import Any, Literal

import tyro

from marl_mm.commands.options import CORES, CollectorsSettings, OwnTask, configs_of
from marl_mm.commands.output import print_evaluations, print_rows, show
from marl_mm.commands.parser import command
from marl_mm.commands.wording import as_options
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.cross_play import CrossPlay
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.robustness import Robustness
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bars
from marl_mm.runs.evaluate import (
    Evaluated,
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
from marl_mm.runs.robustness import cross_play, robustness
from marl_mm.sim.config import Engine


@command
def main(
    policies: tyro.conf.Positional[tuple[str, ...]],
    *,
    suite: Literal["robustness"] | None = None,
    partners: tuple[str, ...] = (),
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
        suite: Suite of disturbances, each beside the clean run: actions that are late,
            views that are lost or noisy, a frozen agent, other payload and friction,
            three strengths each, and the other engine. What does not apply is named.
        partners: Other runs of the same task: one agent of each run is replaced by that
            of each other one, for the matrix of what such teams reach.
        episodes: Number of goals: half ahead and half behind, where the task does not
            draw its own.
        seed: Seed of the goals and of random policies.
        task: Registered name of the task.
        max_steps: Steps per episode; default the task's.
        engine: Engine of the simulation; default the runs' own, or bullet, or
            mujoco without PyBullet.
        workers: Processes; the result does not depend on their number.
        out: JSON file to write everything to, a row per episode, after each policy.
        overwrite: Replace OUT if it exists.
        json: Print everything, with one row per episode, as JSON.
        settings: Settings of collectors' policies.
    """
    if not policies:
        raise UsageError(
            f"no policy given, expected run folders or {', '.join(policy_names())}"
        )
    if out is not None:
        refuse_existing(out, overwrite, file=True)
    both = *policies, *partners
    task = own_task(both) if task is None else task
    engine = own_engine(both) if engine is None else engine
    variant = make_task(task, task_overrides(max_steps, engine))
    configs = configs_of(both, settings)
    for name, config in zip(both, configs, strict=True):  # before any work is done
        load_policy(name, variant, config)
    with progress_bars() as bar:
        goals: dict[str, Any] = {"episodes": episodes, "seed": seed, "task": task}
        goals |= {"max_steps": max_steps, "engine": engine, "workers": workers}
        goals["progress"] = bar
        own = [*zip(policies, configs, strict=False)]
        results: dict[int, Evaluated] = {}

        def keep(number: int, result: Evaluated) -> None:
            if out is not None:  # Ctrl-C leaves a whole file
                kept = [*(results | {number: result}).values()]
                save_evaluations(kept, out, overwrite or bool(results))
            results[number] = result

        for number, (name, config) in enumerate(own):
            if suite:
                robustness(name, config=config, keep=partial(keep, number), **goals)
            elif not partners:
                keep(number, evaluate(name, config=config, **goals))
        if partners:
            cross_play(both, configs=configs, keep=partial(keep, len(own)), **goals)
    if json:
        show(evaluations_json([*results.values()]))
        return
    if alone := [one for one in results.values() if isinstance(one, Evaluation)]:
        print_evaluations(alone)
    for result in results.values():
        if isinstance(result, Robustness | CrossPlay):
            rows = [
                dict(zip(result.header, r, strict=True)) for r in result.table_rows()
            ]
            print_rows(rows, as_json=False, title=result.title)
            print(as_options(result.note))
