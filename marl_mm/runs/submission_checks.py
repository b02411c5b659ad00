"""Reading of submissions, which may come from strangers: files, rows and claims agree.

Nothing is run, no path is taken from a file, and weights hold numbers only.
"""

import os
import re
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.run_config import RunConfig
from marl_mm.config_diff import as_json, changes
from marl_mm.envs.registry import TASKS, config_dict
from marl_mm.envs.task import Task
from marl_mm.errors import LayoutError, SubmissionError, UsageError
from marl_mm.eval.rows import MOST_COLUMNS
from marl_mm.plugins import record
from marl_mm.received import Refusal, check_kind, damage_named, read_json
from marl_mm.runs.folder import EVALUATION
from marl_mm.runs.submission import (
    FILES,
    FORMAT,
    MANIFEST,
    MEANS,
    Submission,
    described,
    files_of,
    read_run,
    refuse_mixed,
    seal,
)
from marl_mm.sim.config import ENGINES, engine_of

_SEEDS = 100
"""Largest number of seeds."""

_NAME = re.compile(r"[^=+@\s-][^\x00-\x1f\x7f]{,199}")
"""Name of an algorithm, or a dataset's id or path: no formula of a spreadsheet."""

_MORE_STEPS = 10
"""Largest factor by which episodes may be longer than the task's own."""

_KINDS: dict[str, Any] = {
    "seeds": list[int],
    "task_config": dict[str, Any],
    "packages": dict[str, str],
    "machine": dict[str, str],
    "files": dict[str, str],
    "claims": dict[str, float | list[float]],
}
"""Types of the manifest's values that are not compared with the seeds' files."""


def read_submission(folder: str | Path) -> Submission:
    """A submission whose files, rows and claims agree; nothing is scored.

    Raises:
        UsageError: If there is none, or its task is not registered.
        SubmissionError: If something has been changed.
        CheckpointError: If a file of a seed is damaged.
    """
    if not isinstance(folder, str | Path):
        raise UsageError(f"{folder!r:.80} is no folder, expected a submission's")
    folder = Path(folder)
    if not (folder / MANIFEST).exists():
        raise UsageError(
            f"no submission at {folder}, expected a folder made by marl-mm submit"
        )
    with damage_named(str(folder), SubmissionError):
        manifest = _read_manifest(folder)
        _check_files(folder, manifest)
        runs = tuple(read_run(folder / str(seed)) for seed in manifest["seeds"])
        submission = Submission(folder, manifest, runs)
        named = [(str(run.folder), run.config) for run in runs]
        refuse_mixed(named, SubmissionError)
        check_names(str(folder), runs[0].config)
        _check_task(submission)
        _check_rows(submission)
        _check_claims(submission)
        _check_weights(submission)
    return submission


def _read_manifest(folder: Path) -> dict[str, Any]:
    where = str(folder / MANIFEST)
    manifest: dict[str, Any] = read_json(folder / MANIFEST, SubmissionError)
    check_kind(manifest, dict[str, Any], where, SubmissionError)
    if manifest.get("format") != FORMAT:
        raise SubmissionError(f"{where} is no {FORMAT!r} file")
    for name, kind in _KINDS.items():
        check_kind(manifest.get(name), kind, f"{where}: {name}", SubmissionError)
    if seal(manifest) != manifest.get("fingerprint"):
        raise SubmissionError(f"{where} has been changed: its fingerprint is another")
    seeds = manifest["seeds"]
    check_number(where, len(seeds))
    if min(seeds) < 0:
        raise SubmissionError(f"{where} has the seed {min(seeds)}, expected >= 0")
    return manifest


def check_number(where: str, seeds: int, refusal: Refusal = SubmissionError) -> None:
    """Raise unless there are seeds, and not too many."""
    if not 0 < seeds <= _SEEDS:
        raise refusal(f"{where} has {seeds} seeds, expected 1 to {_SEEDS}")


def _check_files(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Raise unless the folder has the seeds' files, as they were, and no other."""
    seeds = [str(seed) for seed in manifest["seeds"]]
    known = {MANIFEST, *seeds, *(f"{seed}/{name}" for seed in seeds for name in FILES)}
    for home, folders, files in os.walk(folder):
        for path in (Path(home, name) for name in (*folders, *files)):
            inner = str(path.relative_to(folder))
            if inner not in known or path.is_symlink():
                raise SubmissionError(
                    f"{folder} holds {inner!a:.80}, expected {MANIFEST}, a folder per "
                    f"seed with {', '.join(FILES)}, and no links"
                )
    found, recorded = files_of(folder, manifest["seeds"]), manifest["files"]
    for name in sorted(found.keys() | recorded.keys()):
        if found.get(name) != recorded.get(name):
            raise SubmissionError(
                f"{folder}: {name!a:.80} is not the manifest's file, by its SHA-256"
            )


def check_names(
    where: str, config: RunConfig, refusal: Refusal = SubmissionError
) -> None:
    """Raise unless the names that a board shows are short and plain."""
    data = (config.dataset or {"id": "own"}).get("id", "")
    for of, name in (("algorithm", config.algorithm), ("id", data)):
        if not _NAME.fullmatch(name):
            raise refusal(
                f"{where}: {of} is {name!a:.80}, expected at most 200 "
                "letters, digits and spaces on a line, and no formula"
            )


def check_steps(
    where: str, task: Task, name: str, refusal: Refusal = SubmissionError
) -> None:
    """Raise for episodes that are much longer than those of the registered task."""
    most = _MORE_STEPS * TASKS.get(name).max_steps
    if task.max_steps > most:
        raise refusal(
            f"{where} has episodes of {task.max_steps:,} steps, expected at most "
            f"{most:,}"
        )


def _check_task(submission: Submission) -> None:
    """Raise unless the task has its own settings, here and where it was scored."""
    folder, evaluation = submission.folder, submission.runs[0].evaluation
    overrides = {"simulation": {}, **evaluation.overrides}
    replaced = {*overrides} - {"max_steps", "simulation"}
    replaced |= {*overrides["simulation"]} - {"engine"}
    if replaced:
        raise SubmissionError(
            f"{folder} replaces {', '.join(sorted(replaced))} of its task, expected no "
            "other settings than max_steps and the engine"
        )
    try:
        task = submission.task
    except UsageError as error:
        raise SubmissionError(f"{folder}: {error}") from error
    check_steps(str(folder), task, evaluation.task)
    here, there = config_dict(task), submission.manifest["task_config"]
    absent = {name: None for name in there.keys() - here.keys()}
    if differing := list(changes(there, absent | as_json(here))):
        raise SubmissionError(
            f"{folder} was scored in {evaluation.task} of other settings: "
            f"{', '.join(differing[:6]):.300}"
        )
    for name, digest in record(TASKS.origin(evaluation.task)).items():
        if any(run.config.plugins.get(name) != digest for run in submission.runs):
            raise SubmissionError(f"{folder} was made with another {name} than is here")


def _check_rows(submission: Submission) -> None:
    """Raise unless the rows are of the task's goals, each once and in order."""
    first = submission.runs[0].evaluation
    columns = {key for run in submission.runs for r in run.evaluation.rows for key in r}
    if len(columns) > MOST_COLUMNS:
        raise SubmissionError(
            f"{submission.folder}: rows have {len(columns):,} columns, expected at "
            f"most {MOST_COLUMNS:,}"
        )
    setting = first.task, first.overrides, first.engine, first.seed
    goals = [(plan.index, plan.seed) for plan in submission.plans]
    for run in submission.runs:
        own = run.evaluation
        if (own.task, own.overrides, own.engine, own.seed) != setting or (
            (run.config.task, run.config.engine) != (own.task, engine_of(own.overrides))
        ):
            raise SubmissionError(f"{run.folder}: its rows are not of the same setting")
        package, _ = ENGINES[engine_of(own.overrides)]
        version = submission.manifest["packages"].get(package)
        if own.engine_version != version:
            raise SubmissionError(
                f"{run.folder} was scored by {own.engine!a:.60}, the manifest has "
                f"{package} {version!a:.40}"
            )
        rows = [(row["index"], row["seed"]) for row in own.rows]
        if rows != goals:
            pairs = enumerate(zip(rows, goals, strict=False))
            unlike = (number for number, (row, goal) in pairs if row != goal)
            wrong = next(unlike, min(len(rows), len(goals)))
            raise SubmissionError(
                f"{run.folder}: row {wrong} is not of goal {wrong} of seed {own.seed}, "
                f"expected {len(goals)} goals, each once and in order"
            )


def _check_claims(submission: Submission) -> None:
    """Raise unless what the manifest says follows from the seeds' files."""
    folder, manifest = submission.folder, submission.manifest
    follows = as_json(described(submission.runs))
    claims, claimed = follows.pop("claims"), manifest["claims"]
    if other := sorted({*claimed} - {*claims}):
        raise SubmissionError(f"{folder} claims {other[0]!a:.80}, which is not scored")
    known = {*follows, *_KINDS, "format", "fingerprint"}
    _refuse_others(folder / MANIFEST, manifest.keys() - known)
    for run in submission.runs:
        rows = run.folder / EVALUATION
        values = run.evaluation.to_json()
        said = read_json(rows, SubmissionError)
        _refuse_others(rows, said.keys() - (values.keys() - {*MEANS}))
        values |= {"policy": run.config.algorithm, "policy_config": {}}
        for name in ("policy", "policy_config", "engine"):
            if said.get(name) != values[name]:
                expected = values[name]
                raise SubmissionError(
                    f"{rows}: {name} is {said.get(name)!a:.80}, expected {expected!a}"
                )
    for name, value in claims.items():
        said = claimed.get(name, [])
        if np.shape(said) != np.shape(value) or not np.allclose(said, value, 1e-9):
            raise SubmissionError(
                f"{folder} claims that {name} is {said!s:.80}, by its rows it is "
                f"{value!s:.80}"
            )
    for name, value in follows.items():
        if manifest.get(name) != value:
            raise SubmissionError(
                f"{folder}: {name} is {manifest.get(name)!a:.80} in the manifest, "
                f"{value!a:.80} in the seeds' files"
            )


def _refuse_others(file: Path, names: Set[str]) -> None:
    """Raise for values that are not a submission's, and that nobody checks."""
    if names:
        raise SubmissionError(
            f"{file} has {sorted(names)[0]!a:.80}, which nobody checks"
        )


def _check_weights(submission: Submission) -> None:
    """Raise unless each seed has weights of its own, for the task's layout."""
    known: dict[str, Path] = {}
    for run in submission.runs:
        try:
            run.policy.begin(np.random.default_rng(0), submission.task.layout)
        except LayoutError as error:
            raise SubmissionError(f"{run.folder}: {error}") from error
        twin = known.setdefault(run.policy.fingerprint, run.folder)
        if twin != run.folder:
            raise SubmissionError(f"{run.folder} has the weights of {twin}")
