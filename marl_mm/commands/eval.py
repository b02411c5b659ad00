"""marl-mm eval: policies side by side on the same goals."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.commands.options import (
    REGISTERED,
    config_of,
    print_evaluations,
    with_policies,
)
from marl_mm.commands.parser import parse_options
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
from marl_mm.runs.policies import load_policy, own_task, policy_names
from marl_mm.workers import available_cores


@dataclass(frozen=True)
class Eval:
    """Evaluate runs and scripted policies on fixed goals."""

    policies: tyro.conf.Positional[tuple[str, ...]]
    """Run folders, checkpoint files, "pretrained" or names of collectors."""

    episodes: int = 100
    """Number of goals: half ahead and half behind, where the task does not draw its
    own."""

    seed: int = 0
    """Seed of the goals and of random policies."""

    task: Annotated[
        str | None,
        tyro.conf.arg(help=f"{REGISTERED}; default the runs' own, or Reach-v0."),
    ] = None

    max_steps: int | None = None
    """Steps per episode; default the task's."""

    workers: int = field(default_factory=available_cores)
    """Processes; the result does not depend on their number."""

    out: Path | None = None
    """JSON file to write everything to, with a row per episode."""

    overwrite: bool = False
    """Replace OUT if it exists."""

    json: bool = False
    """Print everything, with one row per episode, as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm eval``."""
    options = parse_options(with_policies(Eval), "marl-mm eval", arguments)
    if not options.policies:
        raise UsageError(
            f"no policy given, expected run folders or {', '.join(policy_names())}"
        )
    if options.out is not None:
        refuse_existing(options.out, options.overwrite)
    task = options.task or own_task(options.policies)
    own = make_task(task, task_overrides(options.max_steps))
    for name in options.policies:  # before any work is done
        load_policy(name, own, config_of(name, options))
    with progress_bars() as bar:
        evaluations = [
            evaluate(
                name,
                episodes=options.episodes,
                seed=options.seed,
                task=task,
                max_steps=options.max_steps,
                workers=options.workers,
                progress=bar,
                config=config_of(name, options),
            )
            for name in options.policies
        ]
    if options.out is not None:
        save_evaluations(evaluations, options.out, options.overwrite)
    if options.json:
        print(json.dumps(evaluations_json(evaluations), indent=2))
    else:
        print_evaluations(evaluations)
