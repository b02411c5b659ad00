"""marl-mm eval: policies side by side on the same goals."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.commands.options import (
    REGISTERED,
    check_positive,
    check_seed,
    named_policy,
    own_task,
    policy_names,
    print_evaluations,
    with_policies,
)
from marl_mm.commands.parser import parse_options
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import evaluate
from marl_mm.files import refuse_existing, write_json
from marl_mm.progress import progress_bar
from marl_mm.versions import versions
from marl_mm.workers import available_cores


@dataclass(frozen=True)
class Eval:
    """Evaluate runs and scripted policies on fixed goals."""

    policies: tyro.conf.Positional[tuple[str, ...]]
    """Run folders, checkpoint files, "pretrained" or names of collectors."""

    episodes: int = 100
    """Goals: half ahead and half behind, where the task does not draw its own."""

    seed: int = 0
    """Of the goals and of random policies."""

    task: Annotated[
        str | None,
        tyro.conf.arg(help=f"{REGISTERED}; default the runs' own, or Reach-v0."),
    ] = None

    max_steps: int | None = None
    """Steps per episode; default the task's."""

    workers: int = field(default_factory=available_cores)
    """Processes; the result does not depend on it."""

    out: Path | None = None
    """Also write everything, with one row per episode, to this JSON file."""

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
    check_positive(episodes=options.episodes, workers=options.workers)
    check_seed(options.seed)
    overrides = {}
    if options.max_steps is not None:
        check_positive(max_steps=options.max_steps)
        overrides["max_steps"] = options.max_steps
    if options.out is not None:
        refuse_existing(options.out, options.overwrite)
    task = options.task or own_task(options.policies)
    own = make_task(task, overrides)
    policies = [named_policy(name, options, own) for name in options.policies]
    evaluations = []
    for name, policy in zip(options.policies, policies, strict=True):
        with progress_bar(f"eval {Path(name).name}", options.episodes) as advance:
            evaluations.append(
                evaluate(
                    policy,
                    options.episodes,
                    options.seed,
                    task,
                    overrides,
                    options.workers,
                    advance,
                )
            )
    evaluations = [
        replace(evaluation, policy=name)
        for name, evaluation in zip(options.policies, evaluations, strict=True)
    ]
    made_with = {"packages": versions()}
    values = [evaluation.to_json() | made_with for evaluation in evaluations]
    if options.out is not None:
        write_json(options.out, values)
    if options.json:
        print(json.dumps(values, indent=2))
    else:
        print_evaluations(evaluations)
