"""Figures and tables of online learning, from raw run folders or from their rows."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import FOLDER, load_pretrained, ship
from marl_mm.commands.ablate_check import check_tables
from marl_mm.commands.ablate_rows import (
    CURVES,
    best_run,
    curves_of,
    keep_made_of,
    keep_rows,
    rows_of,
)
from marl_mm.commands.ablate_runs import Ablate, told_missing, train_missing
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.alpha_study import ALPHAS, alpha_steps, summarize_worth, worth_rows
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import (
    SETTINGS,
    OnlineSetting,
    evaluation_rows,
    summarize_settings,
)
from marl_mm.eval.online_figures import alpha_figure, seed_curves
from marl_mm.eval.online_tables import (
    alpha_worth_table,
    online_text,
)
from marl_mm.eval.rows import as_read, read_rows, to_json, write_csv
from marl_mm.eval.video import film_both_ways, film_strip
from marl_mm.files import refuse_existing
from marl_mm.policy import Policy
from marl_mm.progress import progress_bar

COMPARED = {
    "tuned preset": ("ddpg", "ddpg-her", "maddpg-her"),
    "paper preset": ("ddpg-paper", "ddpg-her-paper"),
}
"""Settings in Figs 4 and 5, by panel."""

DEMONSTRATED = {
    "Reach-v0": ("ddpg", "ddpg-her", "ddpg-demonstrations", "ddpg-her-demonstrations"),
    "Grasp-v0": ("ddpg-her-grasp", "ddpg-her-grasp-demonstrations"),
}
"""Settings with a dataset beside, and without, by panel."""

CHOOSING = ("ddpg-her", "ddpg-her-smooth", "maddpg-her-smooth")
"""Settings whose learnt alpha is looked at."""

CUT_OFF = -30
"""Lowest return in Fig. 4: few agents that have learnt nothing drive off, to -200."""

PERCENT = {"scale": 100.0, "bottom": -3.0, "top": 103.0}
"""How success rates are drawn."""

FPS = 1
"""Pictures per simulated second and step, of which Fig. 6 takes five an episode."""

EVALUATIONS = "evaluations.csv.gz"
GOALS, STEPS = "alpha_goals.csv.gz", "alpha_steps.csv"


@dataclass(frozen=True)
class Target:
    """Something that can be made of online runs."""

    about: str
    """For helps."""

    make: Callable[[Ablate], Sequence[Row] | None]
    """Returns the rows of its table, if it has one."""

    files: tuple[str, ...] = ()
    """What it draws."""

    settings: tuple[str, ...] = ()
    """Whose runs it needs; none: those that are asked for, or all."""


def ablate_online(options: Ablate, name: str) -> Sequence[Row] | None:
    """Make a target: of runs, which are trained if they are missing, or of rows.

    Returns:
        Rows of its table, if it was made and has one.

    Raises:
        UsageError: If something stands there already, or rows are missing.
        OtherConfigError: If a run was made with something else.
        MarlMmError: With ``--check``, if a file is not what is drawn.
    """
    target = TARGETS[name]
    if options.check and options.settings is not None:
        raise UsageError("--check is for the whole table, without --settings")
    if options.plan:
        names = target.settings or [setting.name for setting in _settings(options)]
        print(told_missing(options, names))
        return None
    if not options.check:
        again = options.overwrite or options.resume
        return target.make(replace(options, overwrite=again))
    tables = [file for file in target.files if file.endswith(".csv")]
    if not tables:
        raise UsageError(f"--check is for tables, and {name} has none")

    def draw(folder: Path) -> None:
        rows = options.results_folder()
        quiet = replace(options, out=folder, rows=rows, check=False, quiet=True)
        target.make(quiet)

    check_tables(options.results_folder(), tables, draw)
    return None


def check_settings(options: Ablate, target: str) -> None:
    """Raise if ``--settings`` names what is not there, or is not for a target.

    Raises:
        UsageError: Saying what is.
    """
    if options.settings is None:
        return
    known = [setting.name for setting in SETTINGS]
    unknown = [name for name in options.settings if name not in known]
    if unknown or not options.settings:
        missing = f"no setting {unknown[0]!r}" if unknown else "--settings is empty"
        raise UsageError(f"{missing}: expected {', '.join(known)}")
    if target not in ("runs", "online"):
        raise UsageError(f"--settings is for runs and online; {target} has its own")


# --- Targets -----------------------------------------------------------------


def _runs(options: Ablate) -> None:
    names = [setting.name for setting in _settings(options)]
    train_missing(options, names)
    seeds = ", ".join(map(str, options.seeds))
    print(f"{options.runs_folder()}: {', '.join(names)}; seeds {seeds}")


def _online(options: Ablate) -> list[Row]:
    settings = _settings(options)
    stem = "online" if len(settings) == len(SETTINGS) else "online-part"
    _refuse(options, f"{stem}.csv")
    names = [setting.name for setting in settings]
    curves = curves_of(options, names)
    evaluations = rows_of(options, EVALUATIONS, names, evaluation_rows)
    summary = summarize_settings(curves, evaluations, names)
    text = online_text(summary, settings, curves)
    keep_made_of(options, names)
    keep_rows(options.results(CURVES), curves)
    keep_rows(options.results(EVALUATIONS), evaluations)
    write_csv(options.results(f"{stem}.csv"), summary)
    _print(options, summary, text)
    return summary


def _fig4(options: Ablate) -> None:
    label = f"return of the evaluation, cut off at {CUT_OFF}"
    _compare(options, "fig4", "return_all", label, {"bottom": CUT_OFF})


def _fig5(options: Ablate) -> None:
    _compare(options, "fig5", "success_all", "goals reached [%]", PERCENT)


def _demonstrated(options: Ablate) -> None:
    name, label = "demonstrations", "goals reached [%]"
    _compare(options, name, "success_all", label, PERCENT, DEMONSTRATED)


def _compare(
    options: Ablate,
    name: str,
    key: str,
    label: str,
    look: Mapping[str, float],
    names: Mapping[str, Sequence[str]] = COMPARED,
) -> None:
    """Draw one column of the learning curves of some settings."""
    _refuse(options, f"{name}.png")
    panels = {
        title: {one.name: one.about for one in SETTINGS if one.name in own}
        for title, own in names.items()
    }
    curves = curves_of(options, _flat(names))
    seed_curves(curves, panels, key, label, options.results(f"{name}.png"), **look)
    drawn = (label for labels in panels.values() for label in labels.values())
    _tell(options, f"{options.results(name)}.png: {', '.join(drawn)}")


def _flat(names: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    return tuple(name for own in names.values() for name in own)


def _fig6(options: Ablate) -> None:
    _refuse(options, "fig6.png")
    if options.rows is None:
        run = best_run(options, "ddpg-her")
        policy: Policy = load_policy(run / BEST)
    else:  # who ships is that run's best policy
        policy, run = load_pretrained(), FOLDER
    config = make_task()
    with progress_bar("fig6", 2 * config.max_steps) as advance:
        both = film_both_ways(config, policy, 0, FPS, advance)
    film_strip(options.results("fig6.png"), both.strips)
    told = [f"{len(one)} steps {one.direction}" for one in both.episodes]
    _tell(options, f"{options.results('fig6.png')}: {run}, {', '.join(told)}")


def _alpha(options: Ablate) -> list[Row]:
    _refuse(options, "alpha.png", GOALS, STEPS, "alpha_worth.csv")
    if options.rows is None:
        rows, steps = map(as_read, _held(options))
    else:
        rows, steps = (read_rows(options.rows / name) for name in (GOALS, STEPS))
    summary = summarize_worth(rows)
    write_csv(options.results(GOALS), rows)
    write_csv(options.results(STEPS), steps)
    write_csv(options.results("alpha_worth.csv"), summary)
    labels = {setting.name: setting.about for setting in SETTINGS}
    alpha_figure(steps, summary, labels, options.results("alpha.png"))
    _print(options, summary, alpha_worth_table(summary, SETTINGS))
    return summary


def _held(options: Ablate) -> tuple[list[Row], list[Row]]:
    """Trained agents with the learnt alpha and with held ones, and what they learnt."""
    train_missing(options, CHOOSING)
    small = options.budget == "smoke"
    goals, alphas = (2, ALPHAS[::6]) if small else (100, ALPHAS)
    rows: list[Row] = []
    steps: list[Row] = []
    for name in CHOOSING:
        for seed in options.seeds:
            run = options.runs_folder() / name / str(seed)
            made_of = json.loads((run / "config.json").read_text())
            task = made_of["task"]
            overrides = {k: made_of[k] for k in ("max_steps",) if k in made_of}
            total = goals * (1 + len(alphas))
            with progress_bar(f"{name} {seed}", total) as advance:
                # Goals of seeds 0 and 1 are the runs' own evaluations.
                own, learnt = worth_rows(
                    load_policy(run / BEST),
                    task,
                    goals,
                    2,
                    options.workers,
                    alphas,
                    advance,
                    overrides,
                )
            head: Row = {"setting": name, "seed": seed}
            rows += [head | row for row in own]
            steps += [head | row for row in alpha_steps(task, learnt)]
    return rows, steps


def _pretrained(options: Ablate) -> None:
    folder = options.results(FOLDER.name)
    refuse_existing(folder, options.overwrite)
    run = best_run(options, "ddpg-her")
    ship(run, folder)
    print(f"{folder}: the best policy of {run}")


_KNOWN = f"Settings: {', '.join(setting.name for setting in SETTINGS)}."

TARGETS = {
    "runs": Target(f"Train runs, and draw nothing. {_KNOWN}", _runs),
    "online": Target(
        "Table: success, and episodes to 70 and 95 %, per setting.",
        _online,
        ("online.csv",),
    ),
    "fig4": Target(
        "Fig. 4: return over episodes, with and without hindsight.",
        _fig4,
        ("fig4.png",),
        _flat(COMPARED),
    ),
    "fig5": Target(
        "Fig. 5: success over episodes, with and without hindsight.",
        _fig5,
        ("fig5.png",),
        _flat(COMPARED),
    ),
    "fig6": Target(
        "Fig. 6: film strips of the trained agent, ahead and behind.",
        _fig6,
        ("fig6.png",),
        ("ddpg-her",),
    ),
    "demonstrations": Target(
        "Success over episodes with a dataset beside.",
        _demonstrated,
        ("demonstrations.png",),
        _flat(DEMONSTRATED),
    ),
    "alpha": Target(
        "What alpha the trained agents choose, and what it is worth.",
        _alpha,
        ("alpha.png", "alpha_worth.csv"),
        CHOOSING,
    ),
    "pretrained": Target(
        "The agent that ships: the best DDPG + HER run.",
        _pretrained,
        settings=("ddpg-her",),
    ),
}
"""By name."""


def _settings(options: Ablate) -> list[OnlineSetting]:
    asked = options.settings
    return [one for one in SETTINGS if asked is None or one.name in asked]


def _print(options: Ablate, summary: Sequence[Row], text: str) -> None:
    """The summary as JSON, or the text."""
    _tell(options, to_json(summary) if options.json else text)


def _tell(options: Ablate, text: str) -> None:
    if not options.quiet:
        print(text)


def _refuse(options: Ablate, *names: str) -> None:
    for name in names:
        refuse_existing(options.results(name), options.overwrite)
