"""Resuming a collection: the remains of an earlier one, and whether they fit."""

import shutil
from typing import Any

from marl_mm.config_diff import refuse_other_config
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.journal import Journal, noted
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.episode import Episode
from marl_mm.errors import OtherConfigError


def begun_with(location: Location) -> Provenance | None:
    """The record that a collection began with; None where there is none."""
    if about := noted(location.working):
        return Provenance.from_json(about)
    if not location.folder.exists():
        return None
    return Provenance.from_json(read_metadata(location)["marl_mm"])


def known_attempts(location: Location, about: Origin) -> dict[int, Episode | None]:
    """The attempts behind a dataset, by number; None for those it did not keep."""
    if not location.folder.exists():
        return {}
    dataset = load_dataset(location)
    refuse_other(location, dataset.metadata["marl_mm"], about)
    attempts = dataset.provenance.attempts or 0
    known: dict[int, Episode | None] = dict.fromkeys(range(attempts))
    return known | {episode.index: episode for episode in dataset.episodes}


def refuse_other(location: Location, theirs: dict[str, Any], about: Origin) -> None:
    """Raise if something else was collected there.

    Raises:
        OtherConfigError: Saying what differs.
    """
    who = theirs.get("collector", about.collector)
    if who != about.collector:
        raise OtherConfigError(
            f"{location.name} was collected by {who}, now asked for {about.collector}",
            "choose another `dataset` or add `overwrite=True`",
        )
    refuse_other_config(location.folder, theirs, about.to_json())


def is_complete(location: Location, steps: int) -> bool:
    """Whether the dataset to resume has all its steps."""
    if not location.folder.exists():
        return False
    ours = Provenance.from_json(read_metadata(location)["marl_mm"])
    return ours.complete and ours.steps_asked == steps


def clear(location: Location) -> None:
    """Forget the journal of a dataset that is complete."""
    shutil.rmtree(location.working)


def remove_if_empty(location: Location) -> None:
    """No trace of a collection that kept nothing."""
    journal = location.working / JOURNAL
    if journal.exists():
        with Journal(location.working) as known:
            if len(known):
                return
        journal.unlink()
    if location.working.exists() and not any(location.working.iterdir()):
        location.working.rmdir()
