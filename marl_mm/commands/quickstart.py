"""marl-mm quickstart: the whole chain once, small in size and real in every part.

A PD agent collects a dataset, MABC learns from the dataset's file, and both are
evaluated beside a random agent on the same goals.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.policy import load_policy
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.commands.collect_dataset import CollectOptions, collect_dataset
from marl_mm.commands.offline_options import Offline
from marl_mm.commands.options import (
    check_positive,
    check_seed,
    print_evaluations,
)
from marl_mm.commands.parser import parse_options
from marl_mm.commands.train_offline import train_offline
from marl_mm.datasets.card import card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import run_episodes
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.eval.figures import alpha_over_time
from marl_mm.eval.goals import goal_set
from marl_mm.eval.tables import evaluation_markdown, markdown_table
from marl_mm.eval.video import film_both_ways, film_strip, write_video
from marl_mm.files import new_file, refuse_existing, write_json
from marl_mm.policy import Policy
from marl_mm.progress import progress_bar
from marl_mm.workers import available_cores

EXPERT = PdConfig(alpha_rule="room")
"""The PD agent whose episodes are collected: alpha falls as the hand runs out of room,
which the balance agent can see."""

FPS = 8
"""Of the film."""


@dataclass(frozen=True)
class Size:
    """How much of everything."""

    steps: int
    updates: int
    episodes: int


FULL = Size(steps=1_500, updates=8_000, episodes=100)
SMALL = Size(steps=1_000, updates=8_000, episodes=40)


@dataclass(frozen=True)
class Quickstart:
    """Collect with PD, train MABC, evaluate both and random: a table and a report."""

    out: Path = Path("runs/quickstart")
    """Run folder for everything that is made."""

    seed: int = 0
    """Of dataset, training and goals."""

    workers: int = field(default_factory=available_cores)
    """Processes; the results do not depend on it."""

    small: bool = False
    """Less data and fewer goals: a smoke test of the chain."""

    overwrite: bool = False
    """Replace OUT if it exists."""

    json: bool = False
    """Print wall times, the dataset's card and the evaluations as JSON."""


Stages = dict[str, float]
"""Wall time of each stage [s]."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm quickstart``."""
    options = parse_options(Quickstart, "marl-mm quickstart", arguments)
    check_positive(workers=options.workers)
    check_seed(options.seed)
    refuse_existing(options.out, options.overwrite)
    size = SMALL if options.small else FULL
    out, stages = options.out, Stages()
    try:
        with _timed(stages, "collect (pd)"):
            _collect(options, size)
        with _timed(stages, "train and evaluate (mabc)"):
            learned = _train(options, size)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; start again with --overwrite, or use what is in {out}"
        ) from None
    with _timed(stages, "evaluate (pd, random)"):
        scripted = [
            _evaluate(policy, options, size)
            for policy in (PdPolicy(EXPERT), RandomPolicy(RandomConfig()))
        ]
    evaluations = [learned, *scripted]
    with _timed(stages, "figures and film"):
        _picture(options)
    values = {
        "stages_s": stages,
        "dataset": card(load_dataset(out.resolve() / "dataset")),
        "evaluations": [evaluation.to_json() for evaluation in evaluations],
    }
    write_json(out / "quickstart.json", values)
    with new_file(out / "report.md") as temporary:
        temporary.write_text(_report(options, values, evaluations))
    if options.json:
        print(json.dumps(values, indent=2))
    else:
        print_evaluations(evaluations)
        print(f"{sum(stages.values()):.0f} s; read {out / 'report.md'}")


@contextmanager
def _timed(stages: Stages, name: str) -> Iterator[None]:
    begin = perf_counter()
    yield
    stages[name] = perf_counter() - begin


def _collect(options: Quickstart, size: Size) -> None:
    collection = collect_dataset(
        locate(str(options.out.resolve() / "dataset")),
        "pd",
        EXPERT,
        CollectOptions(
            steps=size.steps,
            seed=options.seed,
            workers=options.workers,
            overwrite=options.overwrite,
        ),
    )
    if not collection.complete:
        raise KeyboardInterrupt


def _train(options: Quickstart, size: Size) -> Evaluation:
    training = Offline(
        algorithm="mabc",
        dataset=str(options.out / "dataset"),
        curve_every=2_000,
        eval_episodes=size.episodes,
        eval_seed=options.seed,
        workers=options.workers,
        overwrite=options.overwrite,
        config=MabcConfig(updates=size.updates),
    )
    dataset = load_dataset(options.out.resolve() / "dataset")
    runs = {options.seed: options.out / "mabc"}
    ((_, evaluation),) = train_offline(dataset, training, runs)
    return evaluation


def _evaluate(policy: Policy, options: Quickstart, size: Size) -> Evaluation:
    with progress_bar(f"eval {policy.name}", size.episodes) as advance:
        return evaluate(
            policy,
            size.episodes,
            options.seed,
            workers=options.workers,
            advance=advance,
        )


def _picture(options: Quickstart) -> None:
    """Alpha over time of learner and expert, a film and a film strip of the learner."""
    out, config = options.out, make_task()
    learned, expert = load_policy(out / "mabc"), PdPolicy(EXPERT)
    plans = goal_set(config, 2, options.seed)
    alpha_over_time(
        {
            policy.name: list(run_episodes(config, policy, plans))
            for policy in (learned, expert)
        },
        out / "alpha.png",
    )
    with progress_bar("film mabc", 2 * config.max_steps) as advance:
        both = film_both_ways(config, learned, options.seed, FPS, advance)
    write_video(out / "mabc.mp4", both.frames, FPS)
    film_strip(out / "mabc.png", both.strips)


def _report(
    options: Quickstart, values: dict[str, Any], evaluations: Sequence[Evaluation]
) -> str:
    dataset = values["dataset"]
    stages = [(name, f"{seconds:.1f}") for name, seconds in values["stages_s"].items()]
    return f"""# Quickstart

Made by `marl-mm quickstart --seed {options.seed}{" --small" * options.small}`.
A PD agent collected {dataset["episodes"]} successful episodes, {dataset["steps"]} steps
(`dataset/`, Minari HDF5). MABC trained two decentralised actors on that file (`mabc/`).
All policies were then evaluated on the same goals, half ahead and half behind.

{evaluation_markdown(evaluations)}
Success: end-effector within 5 cm of the goal in at most 25 steps of 1 s, with Wilson's
interval.
Steps: mean over successes; return: sum of the shared reward; d_mm, d_mp: distance of
hand and base from their targets at the end of a step; jerk: of the base, rms; alpha: 1
stable base ... 0 accurate hand. Means over episodes of each one's mean. The PD agent
lowers alpha from 1 to {EXPERT.alpha} as the hand nears its own base (rule "room").

![film strip](mabc.png)

Film: [mabc.mp4](mabc.mp4)

## Learning curve

![learning curve](mabc/learning_curve.png)

Each point: {Offline.curve_episodes} goals of their own, so coarser than the table.

## Alpha over time

The first goal ahead and the first behind.

![alpha](alpha.png)

## Wall time

{markdown_table(("stage", "seconds"), stages)}"""
