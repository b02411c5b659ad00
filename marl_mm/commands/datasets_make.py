"""Commands that make datasets of other datasets' episodes."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from marl_mm.commands.options import REGISTERED, read_dataset
from marl_mm.datasets.card import card_text, keep_card
from marl_mm.datasets.dataset import existing, load_dataset
from marl_mm.datasets.importing import read_foreign
from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.recipe import Condition, Part, filtered, mix, split, write_mix
from marl_mm.datasets.storage import refuse_foreign, write_alone
from marl_mm.envs.registry import make_task
from marl_mm.episode import IMPORTED
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing
from marl_mm.runs.settings import check_seed


@dataclass(frozen=True, kw_only=True)
class _New:
    overwrite: bool = False
    """Replace what exists."""

    json: bool = False
    """Print the new dataset's card as JSON."""


@dataclass(frozen=True, kw_only=True)
class Mix(_New):
    """Draw so many steps of each of several datasets at random, as whole episodes."""

    parts: tyro.conf.Positional[tuple[str, ...]]
    """DATASET:STEPS, such as good:20000 medium:5000 random:5000."""

    out: str
    """Id or path of the mix."""

    seed: int = 0
    """Seed of the draw."""


@dataclass(frozen=True, kw_only=True)
class Split(_New):
    """Divide a dataset's episodes at random into OUT-first-v0 and OUT-rest-v0."""

    dataset: tyro.conf.Positional[str]
    """Id or path."""

    out: str | None = None
    """Beginning of the new ids; default the dataset's own."""

    share: float = 0.8
    """Share of the episodes that go into the first dataset."""

    seed: int = 0
    """Seed of the draw."""


@dataclass(frozen=True, kw_only=True)
class Filter(_New):
    """Keep the episodes that meet all conditions."""

    dataset: tyro.conf.Positional[str]
    """Id or path."""

    out: str
    """Id or path of the new dataset."""

    outcome: Literal["reached", "missed"] | None = None
    """Only episodes that reached their goal, or only those that did not."""

    direction: Literal["forward", "backward"] | None = None
    """Only episodes whose goal is ahead, or behind."""

    min_return: float | None = None
    """Least sum of rewards."""

    max_return: float | None = None
    """Largest sum of rewards."""


@dataclass(frozen=True, kw_only=True)
class Import(_New):
    """Take a Minari dataset or an HDF5 file of your own.

    Minari's form with goal-dictionary observations: observation, achieved_goal,
    desired_goal, as in the task's layout. Or flat arrays: observations (n, d),
    actions (n, k), next_observations, rewards, terminals, timeouts; or what export
    writes per agent.
    The place where its episodes were collected is not kept: nothing can replay them.
    """

    file: tyro.conf.Positional[Path]
    """HDF5 file, or folder of a Minari dataset."""

    out: str
    """Id or path of the new dataset."""

    task: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"Whose rewards they are: {REGISTERED}; default what the file's "
            'attribute "task" says, and Reach-v0 where it says nothing.'
        ),
    ] = None


def make_mix(command: Mix) -> None:
    """Run ``marl-mm datasets mix``."""
    check_seed(command.seed)
    location = _free(command.out, command.overwrite)
    if not command.parts:
        raise UsageError("name at least one DATASET:STEPS")
    parts = [_part(text) for text in command.parts]
    write_mix(location, mix(parts, command.seed), command.overwrite)
    _tell([location], command.json)


def make_split(command: Split) -> None:
    """Run ``marl-mm datasets split``."""
    check_seed(command.seed)
    source = existing(command.dataset)
    stem = (command.out or source.name).rstrip("/").removesuffix("-v0")
    locations = [
        _free(f"{stem}-{part}-v0", command.overwrite) for part in ("first", "rest")
    ]
    recipes = split(read_dataset(source), command.share, command.seed)
    for location, recipe in zip(locations, recipes, strict=True):
        write_mix(location, recipe, command.overwrite)
    _tell(locations, command.json)


def make_filtered(command: Filter) -> None:
    """Run ``marl-mm datasets filter``."""
    location = _free(command.out, command.overwrite)
    condition = Condition(
        None if command.outcome is None else command.outcome == "reached",
        command.direction,
        command.min_return,
        command.max_return,
    )
    recipe = filtered(read_dataset(command.dataset), condition)
    write_mix(location, recipe, command.overwrite)
    _tell([location], command.json)


def make_imported(command: Import) -> None:
    """Run ``marl-mm datasets import``."""
    location = _free(command.out, command.overwrite)
    if command.task is not None:
        make_task(command.task)  # a wrong one is refused before the file is read
    found = read_foreign(command.file, location.id, command.task)
    longest = max(make_task(found.task).max_steps, int(found.arrays.lengths.max()))
    provenance = Provenance(
        task=found.task,
        overrides={"max_steps": longest},
        collector=IMPORTED,
        origins={location.id: Origin(file=command.file.name)},
    )
    write_alone(location, found.arrays, provenance, command.overwrite)
    _tell([location], command.json)


def _free(name: str, overwrite: bool) -> Location:
    location = locate(name)
    refuse_foreign(location)
    refuse_existing(location.folder, overwrite)
    return location


def _part(text: str) -> Part:
    name, _, steps = text.rpartition(":")
    if not name or not steps.isdecimal():
        raise UsageError(f"{text!r} is no DATASET:STEPS, such as good:20000")
    return Part(read_dataset(name), int(steps))


def _tell(locations: list[Location], as_json: bool) -> None:
    cards = [keep_card(load_dataset(location)) for location in locations]
    if as_json:
        print(json.dumps(cards if len(cards) > 1 else cards[0], indent=2))
    else:
        print("\n\n".join(card_text(values) for values in cards))
