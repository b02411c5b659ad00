"""A run's folder: its config, its evaluations, and whether a run may go on there."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.export_formats import POLICY_FORMATS
from marl_mm.algorithms.loggers import LOGGED
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import METRICS
from marl_mm.config_diff import as_json, refuse_other_config
from marl_mm.datasets.dataset import Dataset
from marl_mm.declared import as_record, with_added
from marl_mm.envs.registry import TASKS
from marl_mm.errors import (
    CheckpointError,
    OtherConfigError,
    OutputExistsError,
    UsageError,
)
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.metrics import EvaluationRow
from marl_mm.files import is_there, refuse_existing, write_json
from marl_mm.plugins import record
from marl_mm.received import check_kind, damage_named, read_json, refuse_links_out
from marl_mm.runs.settings import as_path, check_seeds
from marl_mm.runs.training import SWITCHES, Offline, Online, Training
from marl_mm.sim.config import default_engine
from marl_mm.temporary import remove
from marl_mm.versions import versions

CONFIG = "config.json"
EVALUATION = "eval.json"
BEST_EVALUATION = "eval_best.json"
CURVE = "learning_curve.png"
SB3_BEST = "best.zip"

_MADE_BY_RUNS = (FILE, BEST, METRICS, CURVE, SB3_BEST, *LOGGED)
"""Patterns of a run's files beside its config and what is made of its policies."""

_EVALUATION: dict[str, Any] = {
    "policy": str,
    "policy_config": dict[str, Any],
    "task": str,
    "overrides": dict[str, Any],
    "seed": int,
    "episodes": list[dict[str, Any]],
}
"""Types of an evaluation's fields."""


def check_runs(training: Training, out: Path, seeds: Sequence[int]) -> None:
    """Raise a UsageError that names the first setting that makes no sense."""
    training.check()
    check_seeds(seeds)
    start = training.start if isinstance(training, Offline) else None
    if start is not None and len(seeds) > 1 and (Path(start) / CONFIG).exists():
        raise UsageError(
            f"`start` is a single run, {start}, and `seeds` are {len(seeds)}: expected "
            "one, or a folder of runs by seed; its weights and batches go on"
        )
    if training.resume and (out / CONFIG).exists():
        raise UsageError(
            f"{out} is a run itself: `out` {out.parent} `seeds` {out.name} resumes it"
        )
    if training.resume and not any((out / str(s) / CONFIG).exists() for s in seeds):
        what, others = f"no run in {out} to resume", saved_settings(out).get("seeds")
        if others:
            asked, there = (", ".join(map(str, each)) for each in (seeds, others))
            what = f"no run of `seeds` {asked} in {out} to resume, only of {there}"
        raise UsageError(f"{what}: leave out `resume` to start")


def check_run(
    run: Path, config: RunConfig, training: Training, further: bool = True
) -> None:
    """Raise before any work is done for what would stop a run.

    Args:
        run: Folder of the run.
        config: Record of the run's settings.
        training: Settings that say whether the run may exist already.
        further: Whether a run may go on further than it was to go.

    Raises:
        UsageError: If the run exists, or the one to resume is of another config.
    """
    if not training.resume:
        if (run / CONFIG).exists() and not training.overwrite:
            raise OutputExistsError(
                f"{run} exists already; go on with `resume=True`, choose another "
                "`out` or add `overwrite=True`"
            )
        stopped_at_once = run.is_dir() and not any(run.iterdir())
        refuse_existing(run, training.overwrite or stopped_at_once)
        return
    if not (run / FILE).exists():
        if (run / EVALUATION).exists():
            raise UsageError(
                f"{run} has an {EVALUATION} but no {FILE} to go on from: choose "
                "another `out` or add `overwrite=True`"
            )
        return  # stopped before its first checkpoint, or before its turn
    refuse_other_plugins(run, config, training.allow_changed_plugin)
    _refuse_first_online(run, config)
    may_differ = ["preset", "device", "eval_episodes", "plugins", "start", *SWITCHES]
    may_differ += training.continued if further else ()
    refuse_other(run, config, training.config, may_differ)


def _refuse_first_online(run: Path, config: RunConfig) -> None:
    """Raise a UsageError for a run from a dataset alone that shall go on online."""
    asked = config.settings.get("online_steps")
    if asked and "online_steps" not in read_config(run).settings:
        raise UsageError(
            f"{run} was to end without own episodes: with `start` {run} and another "
            f"`out` a run goes on from it for `online_steps` {asked}"
        )


def refuse_other_plugins(run: Path, config: RunConfig, allowed: bool) -> None:
    """Raise an OtherConfigError for a plug-in that is not the run's, by any name."""
    before, now = read_config(run).plugins, config.plugins
    if allowed or {*before.values()} == {*now.values()}:
        return
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise OtherConfigError(
                f"{run} was made with another {name} (SHA-256 "
                f"{before.get(name, 'none'):.12}, now {now.get(name, 'none'):.12})",
                "go on with that file, or with `allow_changed_plugin=True`",
            )


def refuse_other(
    run: Path, config: RunConfig, settings: Any, ignored: Sequence[str] = ()
) -> None:
    """Raise if a run was made of something else than this config.

    Args:
        run: Folder of the run.
        config: The config.
        settings: Hyper-parameters that are part of it.
        ignored: Names of values that may differ.

    Raises:
        OtherConfigError: Naming what differs.
        CheckpointError: If its config cannot be read.
    """
    begun, current = read_config(run).to_json(), as_json(config.to_json())
    for key in ("packages", *ignored):
        current.pop(key, None)
    for values in (begun, current):  # a dataset may have moved
        if values.get("dataset"):
            values["dataset"].pop("path", None)
    begun, current = (with_added(of, settings) for of in (begun, current))
    refuse_other_config(run, begun, current)


def task_of(training: Training, dataset: Dataset | None) -> str:
    """Name of the task that is evaluated in."""
    if isinstance(training, Online):
        return training.task
    assert isinstance(training, Offline) and dataset is not None
    return training.task or dataset.provenance.task


def run_config(training: Training, dataset: Dataset | None, seed: int) -> RunConfig:
    """The record of a run."""
    task = task_of(training, dataset)
    return RunConfig(
        algorithm=training.algorithm,
        preset=training.preset,
        seed=seed,
        task=task,
        engine=training.engine or default_engine(),
        dataset=dataset.identity() if dataset else None,
        packages=versions(),
        plugins=record(ALGORITHMS.origin(training.algorithm), TASKS.origin(task)),
        settings=training.recorded | as_record(training.config),
    )


def goes_on(run: Path, training: Training) -> bool:
    """Whether a run goes on from a checkpoint."""
    return training.resume and is_there(run / FILE)


def begin_run(run: Path, config: RunConfig, training: Training) -> None:
    """Make a run's folder, or note in it with what plug-ins and settings it goes on."""
    if not goes_on(run, training):
        start_run(run, config)
        return
    settings = config.settings
    continued = {n: settings[n] for n in training.continued if n in settings}
    before = read_config(run)
    now = before.continued(config.plugins, continued)
    if now != before:  # evaluations and exports of its earlier end
        _remove(_made(run, config.task))
    known = {*settings, *now.settings}
    switches = [name for name in ("eval_episodes", *SWITCHES) if name in known]
    now = now.continued(config.plugins, {n: getattr(training, n) for n in switches})
    if now != before:
        write_json(run / CONFIG, now.to_json())


def start_run(run: Path, config: RunConfig) -> None:
    """Make a run's folder with its config; delete what an older run left there."""
    run.mkdir(parents=True, exist_ok=True)
    _remove(chain(_made(run, config.task), *map(run.glob, _MADE_BY_RUNS)))
    write_json(run / CONFIG, config.to_json())


def export_name(file: str, agent: str | None, suffix: str) -> str:
    """Name in a run of a checkpoint's export: an agent's, or None: the joint action."""
    return f"{'best-' if file == BEST else ''}{agent or 'policy'}{suffix}"


def _made(run: Path, task: str) -> Iterator[Path]:
    """Evaluations, of studies' probes too, and exports, under the package's names."""
    yield from (run / EVALUATION, run / BEST_EVALUATION)
    for path in run.glob("eval_*.json"):
        if path.is_file() and b'"probe"' in path.read_bytes():
            yield path
    agents = (None, *(agent.name for agent in TASKS.get(task).layout.agents))
    for file, agent, (_, form) in product((FILE, BEST), agents, POLICY_FORMATS.items()):
        yield run / export_name(file, agent, form.suffix)


def _remove(paths: Iterable[Path]) -> None:
    for path in [*paths]:
        remove(path)


def saved_settings(out: Path) -> dict[str, Any]:
    """Settings of the first run in a folder, by name; none without runs.

    Its dataset counts as ``dataset`` and as ``demonstrations``, and ``seeds`` are those
    of all runs.

    Args:
        out: The folder of the runs, one for each seed.

    Raises:
        CheckpointError: If the first run's config cannot be read.
    """
    names = (config.parent.name for config in out.glob(f"*/{CONFIG}"))
    seeds = sorted(int(name) for name in names if name.isdecimal())
    if not seeds:
        return {}
    return settings_of(read_config(out / str(seeds[0]))) | {"seeds": seeds}


def settings_of(config: RunConfig) -> dict[str, Any]:
    """The settings of a run by name; see ``saved_settings``."""
    settings = config.to_json() | {"seeds": [config.seed]}
    del settings["dataset"]
    if path := (config.dataset or {}).get("path"):
        settings |= {"dataset": path, "demonstrations": path}
    if settings.get("start"):
        settings["start"] = Path(settings["start"])
    del settings["algorithm"]  # what goes on from the run may not be of it, and is told
    return settings


def read_config(path: Path) -> RunConfig:
    """The record of a run, of its folder or of a file.

    Raises:
        CheckpointError: If it cannot be read.
    """
    file = path / CONFIG if path.is_dir() else path
    refuse_links_out(file.parent, [file.name], CheckpointError)
    values = read_json(file, CheckpointError)
    check_kind(values, dict[str, Any], str(file), CheckpointError)
    return RunConfig.from_json(values, str(file))


def existing_config(source: object) -> RunConfig:
    """The record of a run that somebody named; see ``read_config``.

    Raises:
        UsageError: If there is none.
    """
    path = as_path(source, "config", f"a run or its {CONFIG}")
    if not (path / CONFIG).exists() and not path.is_file():
        raise UsageError(f"there is no {str(path)!r}, expected a run or its {CONFIG}")
    return read_config(path)


def read_evaluation(path: Path) -> Evaluation | None:
    """An evaluation in a run's folder; None where there is none.

    Raises:
        CheckpointError: If it cannot be read.
    """
    refuse_links_out(path.parent, [path.name], CheckpointError)
    if not path.exists():
        return None
    return as_evaluation(read_json(path, CheckpointError), str(path))


def as_evaluation(values: Any, where: str) -> Evaluation:
    """An evaluation of a file's values.

    Raises:
        CheckpointError: If they are none.
    """
    check_kind(values, dict[str, Any], where, CheckpointError)
    for name, kind in _EVALUATION.items():
        check_kind(values.get(name), kind, f"{where}: {name}", CheckpointError)
    if not values["episodes"]:
        raise CheckpointError(f"{where} has no episodes, expected at least one")
    for number, row in enumerate(values["episodes"]):
        _check_row(row, f"{where}, episode {number}")
    with damage_named(where, CheckpointError):
        evaluation = Evaluation.from_json(values)
        _ = evaluation.summary
    return evaluation


def _check_row(row: dict[str, Any], where: str) -> None:
    """Raise a CheckpointError for what is no row of an evaluation."""
    for name in sorted(EvaluationRow.__required_keys__ - row.keys()):
        raise CheckpointError(f"{where} lacks {name!r}")
    for name, value in row.items():
        if name in ("direction", "reason"):
            fits, expected = isinstance(value, str), "a text"
        elif name == "success":
            fits, expected = isinstance(value, bool), "true or false"
        elif name == "goal":
            fits = isinstance(value, list) and all(map(_is_number, value))
            expected = "a list of numbers"
        else:
            fits, expected = _is_number(value), "a number"
        if not fits:
            raise CheckpointError(
                f"{where}: {name!r} is {value!r:.60}, expected {expected}"
            )


def _is_number(value: Any) -> bool:
    """Whether a value is a float or an integer of at most 64 bits."""
    if isinstance(value, int):
        return -(2**63) <= value < 2**64
    return isinstance(value, float)
