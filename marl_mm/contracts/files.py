"""Claims about files that others made: datasets, runs, policies, journals, rows.

Each is read as the commands read it, and must be whole, plausible and of known form.
"""

import hashlib
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.export import exported_metadata
from marl_mm.algorithms.export_formats import POLICY_FORMATS
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.pretrained import WEIGHTS
from marl_mm.algorithms.runlog import METRICS, read_metrics
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.card import card_markdown, card_text
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.journal import reading
from marl_mm.datasets.location import locate, text_of
from marl_mm.datasets.plausible import problems_of
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.verify import verify
from marl_mm.envs.registry import make_task
from marl_mm.errors import CheckpointError, DatasetError, UsageError
from marl_mm.eval.rows import read_rows
from marl_mm.received import read_json, refuse_links_out
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    CONFIG,
    EVALUATION,
    as_evaluation,
    read_config,
    read_evaluation,
)
from marl_mm.runs.submission import MANIFEST
from marl_mm.runs.submission_checks import read_submission

_CONTENTS = Callable[[Path], Any]
"""Reads files, and returns what they hold; an error of the package refuses them."""


@dataclass(frozen=True)
class Kind:
    """A kind of files."""

    name: str
    """Name, for messages."""

    fits: Callable[[Path], bool]
    """Whether a path is of this kind, by its name and the names in it."""

    read: _CONTENTS
    """Reads it all, as the commands do."""


def kind_of(path: Path) -> Kind:
    """The kind of a file or folder.

    Raises:
        UsageError: If it is of none that is known.
    """
    for kind in KINDS:
        if kind.fits(path):
            return kind
    names = ", ".join(kind.name for kind in KINDS)
    raise UsageError(f"{path} is of no known kind, expected a {names}")


def fingerprint(path: Path) -> str:
    """Hash of all that a file or folder holds, once it has been read as its kind.

    Raises:
        MarlMmError: If it is damaged.
    """
    digest = hashlib.sha256()
    _update(digest, kind_of(path).read(path))
    return digest.hexdigest()


def _update(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, dict | list | tuple):
        inner = value.items() if isinstance(value, dict) else value
        digest.update(f"{type(value).__name__}{len(value)}".encode())
        for part in inner:
            _update(digest, part)
    else:
        digest.update(repr(value).encode())


def _read_dataset(path: Path) -> Any:
    location = locate(text_of(path))
    if problems := verify(location):
        raise DatasetError("; ".join(problems))
    dataset = load_dataset(location)
    with suppress(UsageError):  # of a plug-in that is not there
        make_task(dataset.provenance.task, dataset.provenance.overrides)
    values = dataset.card()
    card_text(values), card_markdown(values)
    arrays = dataset.arrays
    shown = {key: value for key, value in values.items() if key != "path"}
    return [shown, [vars(episode) for episode in dataset.episodes], arrays.origins]


def _read_policy(path: Path) -> Any:
    policy = load_policy(path)
    _act(policy)
    weights = {
        f"{name}/{key}": value.numpy()
        for name, agent in policy.agents.items()
        for key, value in agent.actor.state_dict().items()
    }
    return [policy.name, policy.layout, weights]


def _act(policy: LearnedPolicy) -> None:
    """Raise unless a policy acts within the bounds."""
    layout = policy.layout
    rng = np.random.default_rng(0)
    policy.begin(rng, layout)
    for state in rng.normal(size=(10, len(layout.state))):
        action = policy.act(state)
        low, high = np.array(layout.low), np.array(layout.high)
        slack = 1e-5 * (high - low)
        if not ((low - slack <= action) & (action <= high + slack)).all():
            raise CheckpointError(f"{policy.name} sets {action}, outside of its bounds")


def _read_submission(path: Path) -> Any:
    submission = read_submission(path)
    policies = [_read_policy(run.folder) for run in submission.runs]
    return [submission.manifest, policies]


def _read_run(path: Path) -> Any:
    results = [path / EVALUATION, path / BEST_EVALUATION]
    names = (CONFIG, FILE, BEST, *(result.name for result in results))
    refuse_links_out(path, names, CheckpointError)
    config = read_config(path)
    metrics = read_metrics(path)
    if metrics and not (path / FILE).exists():
        raise CheckpointError(f"{path} has metrics, but no {FILE}")
    contents: list[Any] = [config.to_json(), metrics]
    for file in (FILE, BEST):
        if (path / file).exists():
            contents.append(_read_policy(path / file))
    for result in results:
        evaluation = read_evaluation(result)
        contents.append(evaluation and evaluation.to_json())
    return contents


def _read_journal(path: Path) -> Any:
    with reading(path) as journal:
        begun = Provenance.from_json(journal.about() or {})
        task = make_task(begun.task, begun.overrides)
        episodes = journal.episodes(task.layout)
    if episodes:
        problems = problems_of(arrays_of(episodes.values(), str(path)))
        longest = max(map(len, episodes.values()))
        if longest > task.max_steps:
            problems.append(f"an episode of {longest} steps, at most {task.max_steps}")
        if problems:
            raise DatasetError(f"{path / JOURNAL}: {'; '.join(problems)}")
    return {number: vars(episode) for number, episode in episodes.items()}


def _read_record(path: Path) -> Any:
    values = read_json(path, CheckpointError)
    if isinstance(values, list):  # what was evaluated together
        each = (as_evaluation(v, f"{path}, {i}") for i, v in enumerate(values))
        return [evaluation.to_json() for evaluation in each]
    if isinstance(values, dict) and "episodes" in values:
        return as_evaluation(values, str(path)).to_json()
    return read_config(path).to_json()


def _read_exported(path: Path) -> Any:
    metadata = exported_metadata(path)
    if not zipfile.is_zipfile(path):
        return metadata
    with zipfile.ZipFile(path) as archive:
        return [metadata, [(part.filename, part.CRC) for part in archive.infolist()]]


def _of_suffix(*suffixes: str) -> Callable[[Path], bool]:
    return lambda path: path.name.endswith(suffixes) and not path.is_dir()


KINDS = (
    Kind("dataset", lambda path: (path / "data").is_dir(), _read_dataset),
    Kind("submission", lambda path: (path / MANIFEST).exists(), _read_submission),
    Kind("shipped policy", lambda path: (path / WEIGHTS).exists(), _read_policy),
    Kind("run", lambda path: (path / CONFIG).exists(), _read_run),
    Kind("journal", lambda path: (path / JOURNAL).exists(), _read_journal),
    Kind("checkpoint", _of_suffix(".pt"), _read_policy),
    Kind(
        "exported policy",
        _of_suffix(*(form.suffix for _, form in POLICY_FORMATS.items())),
        _read_exported,
    ),
    Kind("record", _of_suffix(".json"), _read_record),
    Kind(
        "metrics",
        lambda path: path.name == METRICS,
        lambda path: read_metrics(path.parent),
    ),
    Kind("table of rows", _of_suffix(".csv", ".csv.gz", ".csv.xz"), read_rows),
)
"""All kinds; the first that fits is taken."""
