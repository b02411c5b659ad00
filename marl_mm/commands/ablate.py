"""marl-mm ablate: figures and tables of the paper, and ours, from raw run folders.

Runs that a target needs and that are not there are trained first; finished ones are
kept, interrupted ones go on.
"""

import runpy
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from marl_mm.commands.ablate_check import every_failure
from marl_mm.commands.ablate_draw import drawings
from marl_mm.commands.ablate_offline import ablate_offline
from marl_mm.commands.ablate_online import (
    TARGETS,
    Target,
    ablate_online,
    check_settings,
)
from marl_mm.commands.ablate_options import RESULTS, AblateOffline
from marl_mm.commands.ablate_runs import Ablate, check_installed, told_missing
from marl_mm.commands.options import COMMITTED
from marl_mm.commands.parser import Subcommand, parse_options, parse_subcommand
from marl_mm.commands.sweep_alpha import EPISODES, check_sweep
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.ablation import Ablation
from marl_mm.eval.ablations import ABLATIONS
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import SETTINGS
from marl_mm.eval.rows import to_json
from marl_mm.files import refuse_existing
from marl_mm.runs.settings import check_positive, check_seeds

_ALL = "all"

_DRAWN = {name: target for name, target in TARGETS.items() if target.files}

_SEVERAL = {
    "paper": ("table4", "table5", *(f"fig{number}" for number in range(4, 11))),
    _ALL: (*ABLATIONS, *_DRAWN),
}
"""Targets that are several targets."""

_OF_FILE = ".py:"


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm ablate``."""
    if arguments and _OF_FILE in arguments[0]:
        path, _, name = arguments[0].partition(_OF_FILE)
        own = parse_options(AblateOffline, "marl-mm ablate", arguments[1:])
        own = replace(own, out=own.out or own.runs_folder() / RESULTS)
        _offline(own, {name.lower(): _declared(Path(f"{path}.py"), name)})
        return
    target, options = parse_subcommand(
        {
            **{n: Subcommand(Ablate(), one.about) for n, one in TARGETS.items()},
            **{n: Subcommand(AblateOffline(), a.about) for n, a in ABLATIONS.items()},
            "paper": Subcommand(
                AblateOffline(),
                "The paper's own: Tables 4 and 5 and Figs. 4 to 10, in one night.",
            ),
            _ALL: Subcommand(AblateOffline(), "Every table and figure."),
        },
        "marl-mm ablate",
        "Reproduce figures and tables, training the runs they need. FILE.py:NAME is an "
        "ablation of your own, an object NAME of class marl_mm.eval.Ablation.",
        arguments,
    )
    if target in _SEVERAL:
        _several(options, target)
        return
    if isinstance(options, AblateOffline):
        _offline(options, {target: ABLATIONS[target]})
        return
    check_positive(workers=options.workers)
    check_seeds(options.seeds)
    check_settings(options, target)
    ablate_online(options, target)


def _offline(options: AblateOffline, ablations: Mapping[str, Ablation]) -> None:
    """Draw ablations of offline learning, and print their tables."""
    check_positive(workers=options.workers)
    if options.seeds is not None:
        check_seeds(options.seeds)
    tables: dict[str, Sequence[Row]] = {}
    try:
        _add_tables(tables, options, ablations)
    finally:
        if tables and options.json:
            print(to_json(tables))


def _add_tables(
    tables: dict[str, Sequence[Row]],
    options: AblateOffline,
    ablations: Mapping[str, Ablation],
) -> None:
    """Draw ablations, and take the rows of their tables; print these unless as JSON."""

    def show(name: str, rows: list[Row], text: str) -> None:
        tables[name] = rows
        if not options.json:
            print(f"{ablations[name].about}\n\n{text}")

    ablate_offline(options, ablations, show)


def _declared(path: Path, name: str) -> Ablation:
    """An ablation from somebody's own file.

    Raises:
        UsageError: If there is none of that name.
    """
    if not path.is_file():
        raise UsageError(f"there is no file {path}, expected FILE.py:NAME")
    sys.path.insert(0, str(path.parent))  # of what it imports itself
    try:
        found = runpy.run_path(str(path))
    except MarlMmError as error:
        raise UsageError(f"{path}: {error}") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} cannot be run: {reason:.300}") from error
    finally:
        sys.path.remove(str(path.parent))
    if not isinstance(found.get(name), Ablation):
        known = [key for key, value in found.items() if isinstance(value, Ablation)]
        raise UsageError(
            f"{path} has no Ablation called {name!r}, expected one of "
            f"{', '.join(known) or 'its names: it has none'}"
        )
    ablation: Ablation = found[name]
    return ablation


def _several(options: AblateOffline, name: str) -> None:
    """Several ablations of offline learning, and several of online learning."""
    check_positive(workers=options.workers)
    if options.settings is not None or options.datasets is not None:
        raise UsageError(
            f"--settings and --datasets are for one target, not for {name}"
        )
    offline, online = _parts(options)
    check_seeds(online.seeds)
    ablations = {n: one for n, one in ABLATIONS.items() if n in _SEVERAL[name]}
    targets = {n: one for n, one in _DRAWN.items() if n in _SEVERAL[name]}
    known = [setting.name for setting in SETTINGS]
    settings = {n for one in targets.values() for n in one.settings or known}
    if options.plan:
        _offline(offline, ablations)
        print(f"and online: {told_missing(online, settings)}")
    elif options.check:
        sweep = (options.out or COMMITTED) / "alpha" if name == _ALL else None
        _check_several(offline, online, ablations, targets, sweep)
    else:
        check_installed(online, settings)
        _make_several(offline, online, ablations, targets)


def _parts(options: AblateOffline) -> tuple[AblateOffline, Ablate]:
    """Options of offline and of online learning, each in folders of its own."""

    def part(folder: Path | None, name: str) -> Path | None:
        return None if folder is None else folder / name

    runs, out = options.runs, options.out
    online = Ablate(
        runs=part(runs, "online"),
        out=part(out, "online"),
        seeds=Ablate().seeds if options.seeds is None else options.seeds,
        budget=options.budget,
        # So few episodes are over before other processes have begun.
        workers=1 if options.budget == "smoke" else options.workers,
        check=options.check,
        overwrite=options.overwrite,
        resume=options.resume,
        quiet=options.json,
    )
    offline = replace(options, runs=part(runs, "offline"), out=part(out, "offline"))
    return offline, online


def _make_several(
    offline: AblateOffline,
    online: Ablate,
    ablations: Mapping[str, Ablation],
    targets: Mapping[str, Target],
) -> None:
    """Train what is missing and draw; failures do not stop the others."""
    for target in targets.values():
        for file in target.files:
            refuse_existing(online.results(file), online.overwrite or online.resume)
    tables: dict[str, Sequence[Row]] = {}
    try:
        with every_failure(usage=False) as attempt:
            attempt(partial(_add_tables, tables, offline, ablations))
            for name in targets:
                attempt(partial(_add_table, tables, online, name))
    finally:
        if offline.json:
            print(to_json(tables))


def _add_table(tables: dict[str, Sequence[Row]], options: Ablate, name: str) -> None:
    """Make a target of online learning, and take the rows of its table."""
    rows = ablate_online(options, name)
    if rows is not None:
        tables[name] = rows


def _check_several(
    offline: AblateOffline,
    online: Ablate,
    ablations: Mapping[str, Ablation],
    targets: Mapping[str, Target],
    sweep: Path | None,
) -> None:
    """Check what there are results of, and tell what there are none of."""
    with every_failure() as attempt:
        if sweep is not None and (sweep / EPISODES).exists():
            attempt(partial(check_sweep, sweep))
        for name, ablation in ablations.items():
            files = drawings(name, ablation)
            if any((offline.results() / file).exists() for file in files):
                attempt(partial(_offline, offline, {name: ablation}))
            else:
                print(f"{offline.results() / name}: no results yet")
        for name, target in targets.items():
            if any(file.endswith(".csv") for file in target.files):
                attempt(partial(ablate_online, online, name))
