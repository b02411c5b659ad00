"""What ``marl-mm ablate`` makes by name: studies, and three things made of runs."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import FOLDER, load_pretrained, ship
from marl_mm.envs.registry import make_task
from marl_mm.errors import FailedRunsError
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import as_read, read_rows, write_csv
from marl_mm.eval.studies import online, ours, paper
from marl_mm.eval.studies.alpha import (
    ALPHAS,
    alpha_steps,
    summarize_worth,
    worth_rows,
    worth_table,
)
from marl_mm.eval.studies.data import Tell
from marl_mm.eval.studies.engine import make_rows
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.plan import run_folder
from marl_mm.eval.studies.study import Study
from marl_mm.files import refuse_existing
from marl_mm.progress import Bar

STUDIES = paper.STUDIES | ours.STUDIES | online.STUDIES
"""Studies by name."""

GOALS, STEPS, WORTH = "alpha_goals.csv.gz", "alpha_steps.csv", "alpha_worth.csv"
"""Files of the worth of the learnt alpha: rows, alpha over time, and the table."""

_FPS = 1
"""Pictures per simulated second of Fig. 6, which has five of them an episode."""


@dataclass(frozen=True)
class Extra:
    """Something that is made of the runs of a study."""

    about: str
    """Title."""

    study: Study | None
    """Study whose runs it needs."""

    files: tuple[str, ...]
    """Files or folders that it makes."""

    make: Callable[[StudyOptions, Bar], str]
    """Makes them of finished runs, and returns a text about them."""


def make_extra(name: str, options: StudyOptions, tell: Tell, bar: Bar) -> str:
    """Make something of runs, which are trained if they are missing.

    Args:
        name: Key of ``EXTRAS``.
        options: How studies are run.
        tell: Told what a reader should know while it happens.
        bar: Begins a bar of progress; it is called in a thread.

    Returns:
        Text about what was made.

    Raises:
        UsageError: If it exists.
        FailedRunsError: If runs failed.
    """
    extra = EXTRAS[name]
    for file in extra.files:
        refuse_existing(options.results / file, options.overwrite or options.resume)
    if extra.study is not None:
        _, failed = make_rows({name: extra.study}, options, tell, bar)
        if failed:
            reasons = "; ".join(f"{run}: {why}" for run, why in failed.items())
            raise FailedRunsError(f"{len(failed)} runs failed: {reasons}")
    return extra.make(options, bar)


# --- What alpha is worth -----------------------------------------------------


def _worth(options: StudyOptions, bar: Bar) -> str:
    goals, alphas = (2, ALPHAS[::6]) if options.small else (100, ALPHAS)
    rows: list[Row] = []
    steps: list[Row] = []
    for cell in _CHOOSING.cells:
        for seed in options.seeds_of(_CHOOSING):
            run = run_folder(options, cell, seed)
            made_of = json.loads((run / "config.json").read_text())
            overrides = {k: made_of[k] for k in ("max_steps",) if k in made_of}
            advance = bar(f"{cell[1].name} {seed}", goals * (1 + len(alphas)))
            policy, task = load_policy(run / BEST), made_of["task"]
            # Goals of seeds 0 and 1 are the runs' own evaluations.
            own, learnt = worth_rows(
                policy, task, goals, 2, alphas, overrides, options.workers, advance
            )
            head: Row = {"setting": cell[1].name, "seed": seed}
            rows += [head | row for row in own]
            steps += [head | row for row in alpha_steps(task, learnt)]
    write_csv(options.results / GOALS, rows)
    write_csv(options.results / STEPS, steps)
    return draw_worth(options.results, options.results)


def draw_worth(results: Path, folder: Path) -> str:
    """Write the table and the figure of the learnt alpha's worth, from its rows.

    Args:
        results: Folder of the rows.
        folder: Folder of table and figure.

    Raises:
        UsageError: If there are no rows.
    """
    from marl_mm.eval.studies.figures import alpha_figure  # imports matplotlib

    summary = summarize_worth(read_rows(results / GOALS))
    write_csv(folder / WORTH, summary)
    labels = {setting.name: setting.about for _, setting in _CHOOSING.cells}
    steps = read_rows(results / STEPS)
    alpha_figure(steps, as_read(summary), labels, folder / "alpha.png")
    return worth_table(summary, labels)


# --- The agent that ships ----------------------------------------------------


def _ship(options: StudyOptions, bar: Bar) -> str:
    """The seed whose best policy was best by its learning curve's own goals."""
    (cell,) = _BEST.cells
    curves = options.store.curves(cell, options.seeds_of(_BEST))
    best = max(curves, key=lambda row: (row["success_all"], row["return_all"]))
    run, folder = run_folder(options, cell, best["seed"]), options.results / FOLDER.name
    ship(run, folder)
    return f"{folder}: the best policy of {run}"


def _film(options: StudyOptions, bar: Bar) -> str:
    from marl_mm.eval.video import film_both_ways, film_strip  # imports matplotlib

    task, path = make_task(), options.results / "fig6.png"
    advance = bar("fig6", 2 * task.max_steps)
    both = film_both_ways(task, load_pretrained(), 0, _FPS, advance)
    film_strip(path, both.strips)
    lengths = ", ".join(f"{len(one)} steps {one.direction}" for one in both.episodes)
    return f"{path}: the agent that ships, {lengths}"


_CHOOSING = online.STUDIES["online"].part(
    None, ("ddpg-her", "ddpg-her-smooth", "maddpg-her-smooth")
)
_BEST = online.STUDIES["online"].part(None, ("ddpg-her",))

EXTRAS = {
    "alpha": Extra(
        "What alpha the trained agents choose, and what it is worth.",
        _CHOOSING,
        (WORTH, "alpha.png", GOALS, STEPS),
        _worth,
    ),
    "fig6": Extra(
        "Fig. 6: film strips of the agent that ships, ahead and behind.",
        None,
        ("fig6.png",),
        _film,
    ),
    "pretrained": Extra(
        "The agent that ships: the best DDPG + HER run.", _BEST, (FOLDER.name,), _ship
    ),
}
"""What is made of runs, by name."""

GROUPS = {
    "paper": ("table4", "table5", *(f"fig{number}" for number in range(4, 11))),
    "all": (*STUDIES, "alpha", "fig6"),
}
"""Names that stand for several."""
