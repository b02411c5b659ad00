"""The whole chain once, small in size and real in every part.

A PD agent collects a dataset, MABC learns from the dataset's file, and both are
evaluated beside a random agent on the same goals.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.datasets.card import card
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import run_episodes
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.figures import alpha_over_time
from marl_mm.eval.goals import goal_set
from marl_mm.eval.tables import engines_of, evaluation_markdown, markdown_table
from marl_mm.eval.video import film_both_ways, film_strip, write_video
from marl_mm.files import new_file, refuse_existing, refuse_foreign, write_json
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collect import collect
from marl_mm.runs.evaluate import evaluate
from marl_mm.runs.run import Run
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.runs.train import train
from marl_mm.runs.training import Offline
from marl_mm.sim.config import is_installed

EXPERT = PdConfig(alpha_rule="room")
"""PD agent whose episodes are collected: alpha falls as the hand runs out of room,
which the balance agent can see."""

FPS = 8
"""Pictures per simulated second of the film."""

FULL = {"steps": 1_500, "updates": 8_000, "episodes": 100}
SMALL = {"steps": 1_000, "updates": 8_000, "episodes": 40}
"""Steps of the dataset, updates of the learner, goals of each evaluation."""

_FILM = "![film strip](mabc.png)\n\nFilm: [mabc.mp4](mabc.mp4)"

NO_FILM = "There is no film: PyBullet, which draws it, is not installed."


@dataclass(frozen=True)
class Quickstart:
    """Collect with PD, train MABC, evaluate both and random: a table and a report."""

    out: Path = Path("runs/quickstart")
    """Folder of everything that is made."""

    seed: int = 0
    """Seed of dataset, training and goals."""

    workers: int = 1
    """Processes; the results do not depend on their number."""

    small: bool = False
    """Less data and fewer goals: a smoke test of the chain."""

    overwrite: bool = False
    """Write over the files of a quickstart that is in the folder."""


def run_quickstart(
    options: Quickstart, progress: Bar = silent_bar
) -> tuple[dict[str, Any], list[Evaluation]]:
    """Collect, train, evaluate, and leave a report, figures and a film in a folder.

    Without PyBullet, which draws it, there is no film.

    Args:
        options: Size and place.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Returns:
        Wall times [s], the dataset's card and the evaluations, JSON-serialisable; and
        the evaluations of the learner, its teacher and the random agent.

    Raises:
        UsageError: If a setting makes no sense, or the folder exists, or is none of a
            quickstart.
        KeyboardInterrupt: After Ctrl-C; what is in the folder can be used.
    """
    check_positive(workers=options.workers)
    check_seed(options.seed)
    name, mark = "quickstart.json", '"stages_s"'
    refuse_existing(options.out, options.overwrite)
    if options.out.is_dir() and any(options.out.iterdir()):
        refuse_foreign(options.out, options.overwrite, (name, mark))
    size = SMALL if options.small else FULL
    out, goals = options.out, size["episodes"]
    stages: dict[str, float] = {}
    common: dict[str, Any] = {"workers": options.workers, "progress": progress}
    anew = common | {"overwrite": options.overwrite}
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(out / name, {"stages_s": stages})  # for who stops it
    try:
        with _timed(stages, "collect (pd)"):
            data = collect(
                "pd",
                dataset=out.resolve() / "dataset",
                config=EXPERT,
                steps=size["steps"],
                seed=options.seed,
                **anew,
            )
        with _timed(stages, "train and evaluate (mabc)"):
            (run,) = train(
                "mabc",
                data,
                out=out / "mabc",
                seeds=(options.seed,),
                updates=size["updates"],
                eval_episodes=goals,
                eval_seed=options.seed,
                **anew,
            )
        evaluations = [run.evaluated]
        with _timed(stages, "evaluate (pd, random)"):
            for policy in (PdPolicy(EXPERT), "random"):
                again = evaluate(policy, episodes=goals, seed=options.seed, **common)
                evaluations.append(again)
        with _timed(stages, "figures and film"):
            _picture(run, options, progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; start again with `overwrite=True`, or use what is in {out}"
        ) from None
    values = {
        "stages_s": stages,
        "dataset": card(data),
        "evaluations": [evaluation.to_json() for evaluation in evaluations],
    }
    write_json(out / name, values)
    with new_file(out / "report.md") as temporary:
        temporary.write_text(_report(options, values, evaluations), "utf-8")
    return values, evaluations


@contextmanager
def _timed(stages: dict[str, float], name: str) -> Iterator[None]:
    begin = perf_counter()
    yield
    stages[name] = perf_counter() - begin


def _picture(run: Run, options: Quickstart, progress: Bar) -> None:
    """Alpha over time of learner and expert; film and film strip of the learner."""
    out, task, expert = options.out, make_task(), PdPolicy(EXPERT)
    plans = goal_set(task, 2, options.seed)
    if is_installed("bullet"):  # it draws the pictures
        advance = progress("film mabc", 2 * task.max_steps)
        both = film_both_ways(task, run.policy, options.seed, FPS, advance)
        write_video(out / "mabc.mp4", both.frames, FPS)
        film_strip(out / "mabc.png", both.strips)
        episodes = both.episodes
    else:
        episodes = [*run_episodes(task, run.policy, plans)]
    beside = [*run_episodes(task, expert, plans)]
    alpha_over_time({run.policy.name: episodes, expert.name: beside}, out / "alpha.png")


def _report(
    options: Quickstart, values: dict[str, Any], evaluations: Sequence[Evaluation]
) -> str:
    dataset = values["dataset"]
    run = f"mabc/{options.seed}"
    stages = [(name, f"{seconds:.1f}") for name, seconds in values["stages_s"].items()]
    return f"""# Quickstart

Made by `marl-mm quickstart --seed {options.seed}{" --small" * options.small}`.
A PD agent collected {dataset["episodes"]} successful episodes, {dataset["steps"]} steps
(`dataset/`, Minari HDF5). MABC trained two decentralised actors on that file
(`{run}/`). All policies were then evaluated on the same goals, half ahead (forward)
and half behind (backward).

{evaluation_markdown(evaluations)}
{engines_of(evaluations).capitalize()}.
Success: end-effector within 5 cm of the goal in at most 25 steps of 1 s, with Wilson's
interval.
Steps: mean over successes; return: sum of the shared reward; d_mm, d_mp: distance of
hand and base from their targets at the end of a step; jerk: of the base, rms; alpha: 1
stable base ... 0 accurate hand. Means over episodes of each one's mean. The PD agent
lowers alpha from 1 to {EXPERT.alpha} as the hand nears its own base (rule "room").

{_FILM if is_installed("bullet") else NO_FILM}

## Learning curve

![learning curve]({run}/learning_curve.png)

Each point: {Offline.curve_episodes} goals of their own, so coarser than the table.

## Alpha over time

The first goal ahead and the first behind.

![alpha](alpha.png)

## Wall time

{markdown_table(("stage", "seconds"), stages)}"""
