"""Tables of offline learning; the runs that they need are trained first."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from marl_mm.algorithms.speed import Precision
from marl_mm.commands.ablate_runs import ANOTHER_FOLDER, announce
from marl_mm.commands.collect_paper import paper_location
from marl_mm.commands.offline_options import Offline, check_offline, offline_options
from marl_mm.commands.options import available_cores
from marl_mm.commands.runs import EVALUATION
from marl_mm.commands.train_offline import evaluate_offline_run, train_offline
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED
from marl_mm.errors import (
    DivergedError,
    OtherConfigError,
    UnknownDatasetError,
    UsageError,
)
from marl_mm.eval.metrics import Row
from marl_mm.eval.offline import (
    STUDIES,
    Setting,
    Study,
    evaluation_rows,
    made_by,
    offline_table,
    summarize,
)
from marl_mm.eval.rows import write_csv
from marl_mm.files import new_file, refuse_existing
from marl_mm.progress import progress_bars

_CURVE_EVERY = 5_000
"""Updates: the tables show the end, and evaluations cost as much as training."""


@dataclass(frozen=True)
class AblateOffline:
    """What every table of offline learning needs."""

    runs: Path | None = None
    """Folder of the raw runs, RUNS/DATASET/SETTING/SEED; missing ones are trained;
    default runs/offline, or runs/offline-smoke."""

    out: Path | None = None
    """Folder of tables; default RUNS/results."""

    seeds: tuple[int, ...] = (0, 1, 2)
    """Runs per dataset and setting."""

    datasets: tuple[str, ...] | None = None
    """Those named; default all of the table. What is missing is not made, but the
    command that makes it is told."""

    settings: tuple[str, ...] | None = None
    """Those named; default all of the table."""

    budget: Literal["full", "smoke"] = "full"
    """"smoke": hardly any training, on the dataset that ships, to see that everything
    works."""

    precision: Precision = "medium"
    """Of matrix products; see "marl-mm train td3-bc --help"."""

    workers: int = field(default_factory=available_cores)
    """Seeds that are trained at once, about, and processes that run episodes; the
    result does not depend on it."""

    overwrite: bool = False
    """Replace tables that exist; runs are never replaced."""

    json: bool = False
    """Print the table as JSON."""

    def runs_folder(self) -> Path:
        """``runs`` or its default."""
        name = "offline-smoke" if self.budget == "smoke" else "offline"
        return self.runs or Path("runs") / name

    def results(self, name: str) -> Path:
        """Where a table goes."""
        return (self.out or self.runs_folder() / "results") / name


def draw_table(options: AblateOffline, name: str) -> tuple[list[Row], str]:
    """Train what is missing of a study, and write its table.

    Returns:
        The table's rows, and its text.

    Raises:
        UsageError: If a dataset or a setting is not the study's, or not there.
        OtherConfigError: If a run was made with something else.
    """
    study = STUDIES[name]
    cells = _chosen(study, options)
    files = [
        options.results(f"{name}{end}") for end in (".csv", ".md", "_goals.csv.gz")
    ]
    for file in files:
        refuse_existing(file, options.overwrite)
    names = dict.fromkeys(dataset for dataset, _ in cells)
    datasets = {one: _dataset(options, one) for one in names}
    for dataset, setting in cells:  # before any work is done
        runs = _runs(options, dataset, setting)
        try:
            check_offline(
                datasets[dataset], _training(options, setting), runs, further=False
            )
        except OtherConfigError as error:
            raise OtherConfigError(error.difference, ANOTHER_FOLDER) from error
    wanted = [run for cell in cells for run in _runs(options, *cell).values()]
    missing = [run for run in wanted if not (run / EVALUATION).exists()]
    announce(options.runs_folder(), len(missing), len(wanted))
    for dataset, setting in cells:
        _train_missing(datasets[dataset], options, dataset, setting)
    rows = list(_evaluations(options, cells))
    summary = summarize(rows)
    text = offline_table(summary, study.settings)
    write_csv(files[0], summary)
    with new_file(files[1]) as temporary:
        temporary.write_text(f"# {study.about}\n\n{text}")
    write_csv(files[2], rows)
    return summary, text


def _chosen(study: Study, options: AblateOffline) -> list[tuple[str, Setting]]:
    """The datasets and settings that were asked for."""
    known = dict.fromkeys(dataset for dataset, _ in study.cells)
    datasets = _named("datasets", options.datasets, list(known))
    names = [setting.name for setting in study.settings]
    settings = _named("settings", options.settings, names)
    chosen = [
        (dataset, setting)
        for dataset, setting in study.cells
        if dataset in datasets and setting.name in settings
    ]
    if not chosen:
        raise UsageError(
            f"--settings {' '.join(settings)} are not run on {' '.join(datasets)}: "
            f"expected {', '.join(study.datasets)} for --datasets"
        )
    return chosen


def _named(
    option: str, asked: tuple[str, ...] | None, choices: Sequence[str]
) -> Sequence[str]:
    unknown = [one for one in asked or () if one not in choices]
    if unknown or asked == ():
        missing = f"has no {unknown[0]!r}" if unknown else "is empty"
        raise UsageError(f"--{option} {missing}: expected {', '.join(choices)}")
    return choices if asked is None else asked


def _dataset(options: AblateOffline, name: str) -> Dataset:
    if options.budget == "smoke":
        return load_dataset(SHIPPED)
    try:
        return load_dataset(paper_location(name))
    except UnknownDatasetError as error:
        raise UnknownDatasetError(f"{error}; make it with {made_by(name)}") from error


def _runs(options: AblateOffline, dataset: str, setting: Setting) -> Mapping[int, Path]:
    folder = options.runs_folder() / dataset / setting.name
    return {seed: folder / str(seed) for seed in options.seeds}


def _training(options: AblateOffline, setting: Setting) -> Offline:
    """Options of one setting's runs."""
    small = options.budget == "smoke"
    changes = {**setting.changes, "precision": options.precision}
    if small:
        changes["updates"] = 60
    training: Any = offline_options(
        setting.algorithm,
        setting.preset,
        dataset="",
        eval_episodes=2 if small else setting.goals,
        curve_every=_CURVE_EVERY,
        curve_episodes=1 if small else 20,
        workers=options.workers,
        resume=True,  # what there is of them
    )
    trained: Offline = replace(training, config=replace(training.config, **changes))
    return trained


def _train_missing(
    dataset: Dataset, options: AblateOffline, name: str, setting: Setting
) -> None:
    runs = _runs(options, name, setting)
    missing = {
        seed: run for seed, run in runs.items() if not (run / EVALUATION).exists()
    }
    if not missing:
        return
    print(f"{name}, {setting.about}", file=sys.stderr)
    training = _training(options, setting)
    try:
        for _ in train_offline(dataset, training, missing):
            pass
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped in {options.runs_folder()}; the same command goes on from there"
        ) from None
    except DivergedError as error:
        print(f"{error}; it counts as it is", file=sys.stderr)
        for seed, run in missing.items():
            if not (run / EVALUATION).exists():
                with progress_bars() as bar:
                    evaluate_offline_run(dataset, training, run, bar, f"eval {seed}")


def _evaluations(
    options: AblateOffline, cells: list[tuple[str, Setting]]
) -> Iterator[Row]:
    for dataset, setting in cells:
        for seed in options.seeds:
            yield from evaluation_rows(
                options.runs_folder(), dataset, setting.name, seed
            )
