"""Runs that start with what another has learnt, and go on from there."""

import hashlib
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import BEST, FILE, read_checkpoint
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import METRICS
from marl_mm.config_diff import as_json
from marl_mm.declared import with_added
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.files import new_file
from marl_mm.received import refuse_links_out
from marl_mm.runs.folder import (
    CONFIG,
    read_config,
    refuse_other_plugins,
    saved_settings,
    settings_of,
)
from marl_mm.runs.training import Offline


def start_of(start: str | Path, seed: int) -> Path:
    """Run that a seed starts from: the one that is named, or the seed's in a folder."""
    named = Path(start)
    return named if (named / CONFIG).exists() else named / str(seed)


def started_settings(start: str | Path) -> dict[str, Any]:
    """Settings of the run that another starts from, or of the first of its folder."""
    if not isinstance(start, str | Path):
        raise UsageError(f"`start` is {start!r:.80}, expected a run or its folder")
    if (Path(start) / CONFIG).exists():
        return settings_of(read_config(Path(start)))
    if saved := saved_settings(Path(start)):
        return saved
    raise UsageError(
        f"`start` is {str(start)!r}, and there is no run: expected the folder of a "
        "run, or of runs by seed"
    )


def check_start(training: Offline, config: RunConfig, out: Path) -> None:
    """Raise before any work is done for a run that another cannot start from.

    Args:
        training: Settings of the new run.
        config: Its record.
        out: Its folder.

    Raises:
        UsageError: If there is no such run, or it is of another algorithm, dataset or
            config, or has gone on online itself.
        OtherConfigError: If it is of another plug-in.
        CheckpointError: If it is damaged.
    """
    assert training.start is not None
    start = start_of(training.start, config.seed)
    if not (start / FILE).exists():
        raise UsageError(
            f"`start` is {str(training.start)!r}, and there is no checkpoint in "
            f"{start}: expected the folder of a run, or of runs by seed"
        )
    if start.resolve() == out.resolve():
        raise UsageError(
            f"`start` and the new run are both {out}: choose another `out`"
        )
    before = read_config(start)
    if before.algorithm != training.algorithm:
        raise UsageError(
            f"{start} is a run of {before.algorithm}, expected {training.algorithm}: "
            "what it learnt is of no use to another"
        )
    if before.settings.get("online_steps"):
        raise UsageError(
            f"{start} has gone on online already: `resume=True` and more "
            "`online_steps` go on there"
        )
    refuse_other_plugins(start, config, training.allow_changed_plugin)
    data, now = before.dataset or {}, config.dataset or {}
    if data.get("fingerprint") != now.get("fingerprint"):
        raise UsageError(
            f"{start} learnt from {data.get('id')}, expected {now.get('id')}: what it "
            "sees is scaled by its data, leave out the dataset"
        )
    settings = with_added(before.settings, training.config)
    for name, value in as_json(asdict(training.config)).items():
        if name in settings and settings[name] != value:
            raise UsageError(
                f"{start} was made with {name} = {settings[name]}, expected "
                f"{value}: a run starts with the settings of the other, leave it out"
            )
    step = read_checkpoint(start, training.algorithm)["state"].get("step")
    learnt = isinstance(step, int) and step >= training.config.updates
    if learnt and not training.fine_tuning.online_steps:
        raise UsageError(
            f"{start} has all of its {step} updates and `online_steps` is 0: there is "
            "nothing to learn"
        )
    refuse_links_out(start, [METRICS, BEST, FILE], CheckpointError)


def start_hash(start: Path) -> dict[str, str]:
    """What a run's record holds of the checkpoint that it starts from."""
    with (start / FILE).open("rb") as file:
        return {"start_sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def refuse_changed_start(config: RunConfig) -> None:
    """Raise for a run whose start has another checkpoint than when it was made.

    Raises:
        UsageError: Naming the checkpoint.
    """
    recorded = config.settings.get("start_sha256")
    if recorded is None:
        return
    start = start_of(config.settings["start"], config.seed)
    if not (start / FILE).exists():
        raise UsageError(
            f"there is no checkpoint in {config.settings['start']} any more: name the "
            "run's `start`"
        )
    if start_hash(start)["start_sha256"] != recorded:
        raise UsageError(
            f"{start / FILE} is not the checkpoint that the run started from, as it "
            "has gone on since: name its `start`"
        )


def copy_start(start: Path, run: Path) -> None:
    """Copy what a run has learnt, and its rows; the checkpoint last."""
    for name in (METRICS, BEST, FILE):
        if name == FILE or (start / name).exists():
            with new_file(run / name) as temporary:
                shutil.copyfile(start / name, temporary)
