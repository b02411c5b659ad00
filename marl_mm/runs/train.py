"""Train policies, from a dataset or from episodes of their own."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from marl_mm.algorithms.registry import TUNED, names
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.folder import (
    check_runs,
    existing_config,
    saved_settings,
    settings_of,
)
from marl_mm.runs.run import Run
from marl_mm.runs.seeds import train_seeds
from marl_mm.runs.settings import (
    as_path,
    check_config,
    check_seeds,
    with_settings,
    with_values,
)
from marl_mm.runs.starts import refuse_changed_start, started_settings
from marl_mm.runs.training import Offline, Online, training_of


def train(
    algorithm: str,
    dataset: str | Path | Dataset | None = None,
    *,
    out: str | Path | None = None,
    seeds: Sequence[int] | None = None,
    preset: str | None = None,
    config: Any = None,
    progress: Bar = silent_bar,
    **settings: Any,
) -> list[Run]:
    """Train and evaluate an algorithm, a run for each seed.

    Args:
        algorithm: Name of a registered algorithm.
        dataset: Dataset to learn from, its id or its path; none for an algorithm that
            learns from episodes of its own, which takes ``demonstrations``.
        out: Folder of the runs: seed s goes to ``out/s``; default ``runs/ALGORITHM``,
            with "-online" if it starts from another.
        seeds: Seeds of the runs; default 0, or when resuming those that exist, or
            those of the runs that it starts from.
        preset: Preset of hyper-parameters, tuned, benchmark or paper; default tuned,
            or when resuming the runs' own.
        config: Hyper-parameters in place of the preset's.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        **settings: Fields of ``Offline`` or ``Online`` (``eval_episodes``, ``workers``,
            ``resume`` ...) and of the algorithm's hyper-parameters, by name.

    Raises:
        UsageError: If a setting makes no sense, or a run exists.
        OtherConfigError: If a run to resume was made otherwise.
        DatasetError: If there is nothing to learn from.
        DivergedError: If a seed diverged; the runs of the others are whole.
        KeyboardInterrupt: After Ctrl-C; ``resume=True`` goes on.
    """
    if preset is not None and config is not None:
        raise UsageError("`config` has all hyper-parameters: leave out `preset`")
    training = training_of(algorithm, preset or TUNED)
    folder = default_out(algorithm, settings) if out is None else as_path(out, "out")
    saved: dict[str, Any] = {}
    if start := settings.get("start"):
        settings["start"] = getattr(start, "folder", start)
    if settings.get("resume"):
        saved = saved_settings(folder)
    elif start:
        saved = started_settings(settings["start"])
    if preset is None or (settings.get("resume") and preset == saved.get("preset")):
        training = with_values(training, saved, "config.json", CheckpointError)
    if config is not None:
        check_config(config, training.config)
        values = {field.name: getattr(config, field.name) for field in fields(config)}
        config = with_values(config, values, "config")
        training = replace(training, config=config)
    training = with_settings(algorithm, training, settings)
    if dataset is None and isinstance(training, Offline):
        dataset = saved.get("dataset")
    if seeds is None:
        seeds = saved.get("seeds", (0,))
    check_seeds(seeds)
    seeds = [int(seed) for seed in seeds]
    runs = list(trained(training, dataset, folder, seeds, progress))
    return sorted(runs, key=lambda run: seeds.index(int(run.folder.name)))


def repeat(
    config: RunConfig | Run | str | Path,
    *,
    out: str | Path,
    dataset: str | Path | Dataset | None = None,
    progress: Bar = silent_bar,
    **settings: Any,
) -> Run:
    """Make a run again from its record, to the same bytes on the same machine.

    Args:
        config: Record of the run, as ``load_run(...).config``, the run, or its folder.
        out: Folder of the new run: seed s goes to ``out/s``.
        dataset: Dataset that an offline run learns from in place of its own, its id or
            its path; online it is ``demonstrations``.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        **settings: Settings in place of the run's, by name.

    Raises:
        UsageError: If there is no such run, its dataset or the checkpoint that it
            started from is gone or another, or the new run exists.
    """
    folder = as_path(out, "out")
    if not isinstance(config, RunConfig):
        record_of = config.folder if isinstance(config, Run) else config
        config = existing_config(record_of)
    if others := {"algorithm", "preset"} & settings.keys():
        raise UsageError(f"`{min(others)}` of a repeated run is its own: leave it out")
    if start := settings.get("start"):
        settings["start"] = getattr(start, "folder", start)
    default = training_of(config.algorithm)
    training = with_values(default, settings_of(config), "config.json", CheckpointError)
    training = with_settings(config.algorithm, training, settings)
    if not {"start", "resume"} & settings.keys():
        refuse_changed_start(config)
    if dataset is None and "demonstrations" not in settings:
        of_run = dataset_of(config)
        dataset = of_run if isinstance(training, Offline) else None
    (run,) = trained(training, dataset, folder, (config.seed,), progress)
    return run


def dataset_of(config: RunConfig) -> Dataset | None:
    """The dataset that a run learnt from; None for a run without a dataset.

    Raises:
        UsageError: If the dataset is gone or another by now.
    """
    if config.dataset is None:
        return None
    if "path" not in config.dataset:  # as of a submission
        raise UsageError(
            f"the record does not say where {config.dataset['id']} lies: name the "
            "`dataset`"
        )
    data = load_dataset(config.dataset["path"])
    if data.fingerprint != config.dataset["fingerprint"]:
        raise UsageError(
            f"{config.dataset['path']} has the fingerprint {data.fingerprint}, the run "
            f"learnt from {config.dataset['fingerprint']}: name its `dataset`"
        )
    return data


def trained(
    training: Offline | Online,
    dataset: str | Path | Dataset | None,
    out: Path,
    seeds: Sequence[int],
    bar: Bar,
) -> Iterator[Run]:
    """Runs of the seeds, as they are finished; see ``train``."""
    check_runs(training, out, seeds)
    runs = {seed: out / str(seed) for seed in seeds}
    if isinstance(training, Online):
        refuse_dataset(training.algorithm, dataset)
        dataset = training.demonstrations or None
    elif dataset is None:
        raise UsageError(
            f"{training.algorithm} learns from a dataset: name one, such as good-5k"
        )
    if not isinstance(dataset, Dataset | None):
        dataset = load_dataset(dataset)
    return map(Run, train_seeds(training, dataset, runs, bar))


def default_out(algorithm: str, settings: Mapping[str, Any]) -> Path:
    """Folder of runs where none is named, not that of runs which they start from."""
    end = "-online" if settings.get("start") else ""
    return Path("runs") / f"{algorithm}{end}"


def refuse_dataset(algorithm: str, dataset: object) -> None:
    """Raise a UsageError if an algorithm that learns online is given a dataset."""
    if dataset is not None:
        raise UsageError(
            f"{algorithm} learns from episodes of its own and takes no `dataset`: use "
            f"{', '.join(names(online=False))}, or `demonstrations`"
        )
