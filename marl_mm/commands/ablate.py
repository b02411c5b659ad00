"""marl-mm ablate: figures and tables of the paper, and ours, from raw run folders.

Runs that a target needs and that are not there are trained first; finished ones are
kept, interrupted ones go on.
"""

import json
import math
import runpy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import FOLDER, ship
from marl_mm.commands.ablate_offline import ablate_offline
from marl_mm.commands.ablate_options import AblateOffline
from marl_mm.commands.ablate_runs import Ablate, train_missing
from marl_mm.commands.options import check_positive, check_seeds
from marl_mm.commands.parser import Subcommand, parse_options, parse_subcommand
from marl_mm.envs.config import reach_config
from marl_mm.errors import UsageError
from marl_mm.eval.ablations import ABLATIONS, Ablation
from marl_mm.eval.alpha_study import ALPHAS, alpha_steps, summarize_worth, worth_rows
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import (
    SETTINGS,
    Setting,
    curve_rows,
    evaluation_rows,
    summarize_settings,
)
from marl_mm.eval.online_figures import alpha_figure, seed_curves
from marl_mm.eval.online_tables import online_markdown, worth_of_alpha
from marl_mm.eval.rows import write_csv
from marl_mm.eval.video import film_both_ways, film_strip
from marl_mm.files import new_file, refuse_existing
from marl_mm.progress import progress_bar

COMPARED = ("ddpg", "ddpg-her", "maddpg-her")
"""Settings in Figs 4 and 5."""

CUT_OFF = -30
"""Lowest return in Fig. 4: few agents that have learnt nothing drive off, to -200."""

PERCENT = {"scale": 100.0, "bottom": 0.0, "top": 102.0}
"""How success rates are drawn."""

_ALL = "all"

_DRAWN = ("online", "fig4", "fig5", "fig6", "demonstrations", "alpha")
"""Targets of online learning that draw."""

_OF_FILE = ".py:"

FPS = 1
"""Pictures per simulated second and step, of which Fig. 6 takes five an episode."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm ablate``."""
    if arguments and _OF_FILE in arguments[0]:
        path, _, name = arguments[0].partition(_OF_FILE)
        own = parse_options(AblateOffline, "marl-mm ablate", arguments[1:])
        _offline(own, {name.lower(): _declared(Path(f"{path}.py"), name)})
        return
    target, options = parse_subcommand(
        {
            **{n: Subcommand(Ablate(), about) for n, (about, _) in TARGETS.items()},
            **{n: Subcommand(AblateOffline(), a.about) for n, a in ABLATIONS.items()},
            _ALL: Subcommand(AblateOffline(), "Every table and figure."),
        },
        "marl-mm ablate",
        "Reproduce figures and tables, training the runs they need. FILE.py:NAME is an "
        "ablation of your own, an object NAME of class marl_mm.eval.Ablation.",
        arguments,
    )
    if target == _ALL:
        _everything(options)
        return
    if isinstance(options, AblateOffline):
        _offline(options, {target: ABLATIONS[target]})
        return
    check_positive(workers=options.workers)
    check_seeds(options.seeds)
    known = [setting.name for setting in SETTINGS]
    if options.settings is not None:
        unknown = [name for name in options.settings if name not in known]
        if unknown or not options.settings:
            missing = f"no setting {unknown[0]!r}" if unknown else "--settings is empty"
            raise UsageError(f"{missing}: expected {', '.join(known)}")
        if target not in ("runs", "online"):
            raise UsageError(f"--settings is for runs and online; {target} has its own")
    TARGETS[target][1](options)


def _offline(options: AblateOffline, ablations: Mapping[str, Ablation]) -> None:
    """Draw ablations of offline learning, and print their tables."""
    check_positive(workers=options.workers)
    check_seeds(options.seeds)
    drawn = ablate_offline(options, ablations)
    if options.json:
        tables = {name: _or_null(rows) for name, (rows, _) in drawn.items()}
        print(json.dumps(tables, indent=2))
        return
    for name, (_, text) in drawn.items():
        print(f"{ablations[name].about}\n\n{text}")


def _declared(path: Path, name: str) -> Ablation:
    """An ablation from somebody's own file.

    Raises:
        UsageError: If there is none of that name.
    """
    if not path.is_file():
        raise UsageError(f"there is no file {path}, expected FILE.py:NAME")
    found = runpy.run_path(str(path))
    if not isinstance(found.get(name), Ablation):
        known = [key for key, value in found.items() if isinstance(value, Ablation)]
        raise UsageError(
            f"{path} has no Ablation called {name!r}, expected one of "
            f"{', '.join(known) or 'its names: it has none'}"
        )
    ablation: Ablation = found[name]
    return ablation


def _everything(options: AblateOffline) -> None:
    """All ablations of offline learning, and all targets that are drawn."""
    check_positive(workers=options.workers)
    check_seeds(options.seeds)

    def part(folder: Path | None, name: str) -> Path | None:
        return None if folder is None else folder / name

    runs, out = options.runs, options.out
    online = Ablate(
        runs=part(runs, "online"),
        out=part(out, "online"),
        seeds=options.seeds,
        budget=options.budget,
        workers=options.workers,
        overwrite=options.overwrite,
    )
    offline = replace(options, runs=part(runs, "offline"), out=part(out, "offline"))
    _offline(offline, ABLATIONS)
    for name in _DRAWN:
        TARGETS[name][1](online)


def _settings(options: Ablate) -> list[Setting]:
    if options.settings is None:
        return list(SETTINGS)
    return [setting for setting in SETTINGS if setting.name in options.settings]


# --- Targets -----------------------------------------------------------------


def _runs(options: Ablate) -> None:
    names = [setting.name for setting in _settings(options)]
    train_missing(options, names)
    print(
        f"{options.runs_folder()}: {', '.join(names)}; seeds {_listed(options.seeds)}"
    )


def _online(options: Ablate) -> None:
    files = ("online.csv", "online.md", "curves.csv.gz", "evaluations.csv.gz")
    _refuse(options, *files)
    settings = _settings(options)
    names = [setting.name for setting in settings]
    train_missing(options, names)
    curves, evaluations = _curves(options, names), _evaluations(options, names)
    summary = summarize_settings(curves, evaluations, names)
    text = online_markdown(summary, settings, curves)
    write_csv(options.results("curves.csv.gz"), curves)
    write_csv(options.results("evaluations.csv.gz"), evaluations)
    write_csv(options.results("online.csv"), summary)
    with new_file(options.results("online.md")) as temporary:
        temporary.write_text(text)
    _print(options, summary, text)


def _fig4(options: Ablate) -> None:
    label = f"return of the evaluation, cut off at {CUT_OFF}"
    _compare(options, "fig4.png", "return_all", label, {"bottom": CUT_OFF})


def _fig5(options: Ablate) -> None:
    _compare(options, "fig5.png", "success_all", "goals reached [%]", PERCENT)


def _demonstrated(options: Ablate) -> None:
    settings = ("ddpg", "ddpg-her", "ddpg-demonstrations", "ddpg-her-demonstrations")
    name, label = "demonstrations.png", "goals reached [%]"
    _compare(options, name, "success_all", label, PERCENT, settings)


def _compare(
    options: Ablate,
    name: str,
    key: str,
    label: str,
    look: Mapping[str, float],
    settings: Sequence[str] = COMPARED,
) -> None:
    """Draw one column of the learning curves of some settings."""
    _refuse(options, name)
    train_missing(options, settings)
    labels = {one.name: one.about for one in SETTINGS if one.name in settings}
    seed_curves(
        _curves(options, settings), labels, key, label, options.results(name), **look
    )
    print(f"{options.results(name)}: {', '.join(labels.values())}")


def _fig6(options: Ablate) -> None:
    _refuse(options, "fig6.png")
    train_missing(options, ["ddpg-her"])
    run = _best_run(options, "ddpg-her")
    config = reach_config()
    with progress_bar("fig6", 2 * config.max_steps) as advance:
        both = film_both_ways(config, load_policy(run / BEST), 0, FPS, advance)
    film_strip(options.results("fig6.png"), both.strips)
    told = [f"{len(one)} steps {one.direction}" for one in both.episodes]
    print(f"{options.results('fig6.png')}: {run}, {', '.join(told)}")


def _alpha(options: Ablate) -> None:
    files = ("alpha.png", "alpha_goals.csv.gz", "alpha_steps.csv", "alpha_worth.csv")
    _refuse(options, *files)
    names = ("ddpg-her", "ddpg-her-smooth", "maddpg-her-smooth")
    train_missing(options, names)
    small = options.budget == "smoke"
    goals, alphas = (2, ALPHAS[::6]) if small else (100, ALPHAS)
    rows: list[Row] = []
    steps: list[Row] = []
    for name in names:
        for seed in options.seeds:
            run = options.runs_folder() / name / str(seed)
            task = json.loads((run / "config.json").read_text())["task"]
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
                )
            head: Row = {"setting": name, "seed": seed}
            rows += [head | row for row in own]
            steps += [head | row for row in alpha_steps(task, learnt)]
    summary = summarize_worth(rows)
    write_csv(options.results("alpha_goals.csv.gz"), rows)
    write_csv(options.results("alpha_steps.csv"), steps)
    write_csv(options.results("alpha_worth.csv"), summary)
    labels = {setting.name: setting.about for setting in SETTINGS}
    alpha_figure(steps, summary, labels, options.results("alpha.png"))
    _print(options, summary, worth_of_alpha(summary, SETTINGS))


def _pretrained(options: Ablate) -> None:
    folder = options.results(FOLDER.name)
    refuse_existing(folder, options.overwrite)
    train_missing(options, ["ddpg-her"])
    run = _best_run(options, "ddpg-her")
    ship(run, folder)
    print(f"{folder}: the best policy of {run}")


_KNOWN = f"Settings: {', '.join(setting.name for setting in SETTINGS)}."

TARGETS: dict[str, tuple[str, Callable[[Ablate], None]]] = {
    "runs": (f"Train runs, and draw nothing. {_KNOWN}", _runs),
    "online": ("Table: success, and episodes to 70 and 95 %, per setting.", _online),
    "fig4": ("Fig. 4: return over episodes, with and without hindsight.", _fig4),
    "fig5": ("Fig. 5: success over episodes, with and without hindsight.", _fig5),
    "fig6": ("Fig. 6: film strips of the trained agent, ahead and behind.", _fig6),
    "demonstrations": ("Success over episodes with a dataset beside.", _demonstrated),
    "alpha": ("What alpha the trained agents choose, and what it is worth.", _alpha),
    "pretrained": ("The agent that ships: the best DDPG + HER run.", _pretrained),
}
"""What can be made: for helps, and how."""


def _curves(options: Ablate, names: Sequence[str]) -> list[Row]:
    runs, seeds = options.runs_folder(), options.seeds
    cells = [(name, seed) for name in names for seed in seeds]
    return [row for cell in cells for row in curve_rows(runs, *cell)]


def _evaluations(options: Ablate, names: Sequence[str]) -> list[Row]:
    runs, seeds = options.runs_folder(), options.seeds
    cells = [(name, seed) for name in names for seed in seeds]
    return [row for cell in cells for row in evaluation_rows(runs, *cell)]


def _best_run(options: Ablate, name: str) -> Path:
    """The seed whose best policy was best by its learning curve's own goals."""
    curves = _curves(options, [name])  # max takes the first of equals
    best = max(curves, key=lambda row: (row["success_all"], row["return_all"]))
    return options.runs_folder() / name / str(best["seed"])


def _print(options: Ablate, summary: Sequence[Row], text: str) -> None:
    """The summary as JSON, where null is what could not be measured; or the text."""
    if not options.json:
        print(text)
        return
    print(json.dumps(_or_null(summary), indent=2))


def _or_null(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_or_null(one) for one in value]
    if isinstance(value, dict):
        return {name: _or_null(one) for name, one in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def _refuse(options: Ablate, *names: str) -> None:
    for name in names:
        refuse_existing(options.results(name), options.overwrite)


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))
