"""Datasets made from others' episodes, by mixing, splitting and filtering."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, joined
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.location import Location
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.storage import write_alone
from marl_mm.declared import plain
from marl_mm.errors import UsageError
from marl_mm.sim.config import engine_of, engine_overrides


@dataclass(frozen=True)
class Part:
    """Part of a mix, from one dataset."""

    dataset: Dataset
    """Dataset that the episodes are drawn from."""

    steps: int
    """Least number of steps; episodes stay whole."""


@dataclass(frozen=True)
class Selection:
    """Episodes chosen from datasets, and how."""

    arrays: EpisodeArrays
    """Arrays of the chosen episodes."""

    provenance: Provenance
    """Provenance of the episodes, with the way in which they were chosen."""


def mix(parts: Sequence[Part], seed: int) -> Selection:
    """Draw episodes with so many steps from each dataset, in the order of the parts.

    The episodes of a part are shuffled. The shortest beginning with at least the part's
    steps is taken, and sorted into the order of the dataset.

    Args:
        parts: Parts of the mix, of different datasets.
        seed: Seed of the draw.

    Raises:
        UsageError: If a part has too few steps or is named twice, tasks or engines
            differ, two datasets share a name, or two parts hold the same episode.
    """
    _refuse_incompatible([part.dataset for part in parts])
    chosen = []
    for number, part in enumerate(parts):
        arrays, name = part.dataset.arrays, part.dataset.metadata["dataset_id"]
        if part.steps < 1 or part.steps > arrays.steps:
            raise UsageError(
                f"{name} has {arrays.steps} steps, asked for {part.steps}: expected "
                f"1 to {arrays.steps}"
            )
        order = np.random.default_rng([seed, number]).permutation(len(arrays))
        taken = np.searchsorted(np.cumsum(arrays.lengths[order]), part.steps) + 1
        chosen.append(arrays.select(np.sort(order[:taken])))
    _refuse_twins(chosen, parts)
    asked = {part.dataset.metadata["dataset_id"]: plain(part.steps) for part in parts}
    recipe = {"kind": "mix", "seed": plain(seed), "steps": asked}
    return Selection(
        joined(chosen), _provenance([part.dataset for part in parts], recipe)
    )


def split(dataset: Dataset, share: float, seed: int) -> tuple[Selection, Selection]:
    """Split a dataset into a random share of its episodes, and all others.

    Args:
        dataset: Dataset to split.
        share: Share of the episodes in the first result, strictly between 0 and 1; both
            results have at least one episode.
        seed: Seed of the draw.

    Raises:
        UsageError: If the share makes no sense or there is only one episode.
    """
    count = len(dataset.arrays)
    if not isinstance(share, float | np.floating) or not 0.0 < share < 1.0:
        raise UsageError(f"the share is {share!r:.40}, expected one between 0 and 1")
    if count < 2:
        raise UsageError("one episode cannot be split, expected at least two")
    first = min(max(round(share * count), 1), count - 1)
    order = np.random.default_rng(seed).permutation(count)
    recipe = {"kind": "split", "seed": plain(seed), "share": plain(share)}

    def part(name: str, numbers: np.ndarray) -> Selection:
        described = _provenance([dataset], recipe | {"part": name})
        return Selection(dataset.arrays.select(np.sort(numbers)), described)

    return part("first", order[:first]), part("rest", order[first:])


@dataclass(frozen=True)
class Condition:
    """Condition of a filter: episodes are kept if they meet all fields that are set."""

    success: bool | None = None
    """Whether the kept episodes reached their goal; None keeps both."""

    direction: Literal["forward", "backward"] | None = None
    """Side of the start on which the kept episodes' goals are; None keeps both."""

    min_return: float | None = None
    """Lower bound of the return, a sum of rewards; None for no bound."""

    max_return: float | None = None
    """Upper bound of the return, a sum of rewards; None for no bound."""


def filtered(dataset: Dataset, condition: Condition) -> Selection:
    """Choose the episodes that meet a condition, in order.

    Raises:
        UsageError: If no episode meets it, or no field is set.
    """
    arrays = dataset.arrays
    asked = {key: value for key, value in vars(condition).items() if value is not None}
    if not asked:
        raise UsageError(
            "no condition: expected an outcome, a direction or a bound of the return"
        )
    keep = np.ones(len(arrays), bool)
    if condition.success is not None:
        keep &= arrays.successes() == condition.success
    if condition.direction is not None:
        ahead = arrays.ahead()
        if ahead is None:
            raise UsageError("the episodes' layout has no goal_x: it has no directions")
        keep &= ahead == (condition.direction == "forward")
    if condition.min_return is not None:
        keep &= arrays.returns() >= condition.min_return
    if condition.max_return is not None:
        keep &= arrays.returns() <= condition.max_return
    if not keep.any():
        reached = {True: "reached", False: "missed"}
        words = [
            f"`outcome` {reached[value]}" if key == "success" else f"`{key}` {value}"
            for key, value in asked.items()
        ]
        raise UsageError(
            f"none of the {len(arrays)} episodes has {', '.join(words)}: nothing to "
            "write"
        )
    asked = {key: plain(value) for key, value in asked.items()}
    recipe = {"kind": "filter", "condition": asked}
    return Selection(
        arrays.select(np.flatnonzero(keep)), _provenance([dataset], recipe)
    )


def write_selection(
    location: Location, chosen: Selection, overwrite: bool = False
) -> None:
    """Write chosen episodes as a dataset; see ``write_alone``."""
    write_alone(location, chosen.arrays, chosen.provenance, overwrite)


def _refuse_incompatible(datasets: Sequence[Dataset]) -> None:
    folders: dict[str, Path] = {}
    for dataset in datasets:
        name, folder = dataset.metadata["dataset_id"], dataset.location.folder
        if (first := folders.setdefault(name, folder)) != folder:
            raise UsageError(
                f"{first} and {folder} are both called {name}: make one of them anew "
                "under another name"
            )
    if len(folders) < len(datasets):
        raise UsageError(f"{', '.join(folders)}: expected each dataset once")
    tasks = {dataset.provenance.task for dataset in datasets}
    if len(tasks) > 1:
        raise UsageError(
            f"the datasets are of {', '.join(sorted(tasks))}: their rewards differ"
        )


def _refuse_twins(chosen: Sequence[EpisodeArrays], parts: Sequence[Part]) -> None:
    """Raise if an episode would be in a mix twice.

    Two collections with the same policy and seed begin alike, whatever their names.
    """
    owners: dict[bytes, int] = {}
    for number, arrays in enumerate(chosen):
        for i in range(len(arrays)):
            episode = arrays.episode(i)
            # Random and medium begin alike: the policy is part of the content.
            content = episode.source.encode() + episode.states.tobytes()
            content += episode.actions.tobytes()
            owner = owners.setdefault(hashlib.sha256(content).digest(), number)
            if owner != number:
                twins = (parts[i].dataset for i in (owner, number))
                names = (twin.metadata["dataset_id"] for twin in twins)
                raise UsageError(
                    f"{' and '.join(names)} hold the same episodes: mix one of them, "
                    "or one of another seed"
                )


def _provenance(datasets: Sequence[Dataset], recipe: dict[str, Any]) -> Provenance:
    """Provenance of episodes that were chosen from these datasets.

    Raises:
        UsageError: If two of them record different origins of the same name.
    """
    sources = [dataset.provenance for dataset in datasets]
    origins: dict[str, Origin] = {}
    for source in sources:
        for name, origin in source.origins.items():
            if origins.setdefault(name, origin) != origin:
                raise UsageError(
                    f"two different datasets are called {name}: collect one of them "
                    "under another name"
                )
    engines = sorted({engine_of(source.overrides) for source in sources})
    if len(engines) > 1:
        raise UsageError(
            f"the datasets are of engines {' and '.join(engines)}: choose those of one"
        )
    # Replays and lengths are checked against what the longest episodes were allowed.
    longest = max(source.overrides.get("max_steps", 0) for source in sources)
    steps = {"max_steps": longest} if longest else {}
    return Provenance(
        task=sources[0].task,
        overrides={**steps, **engine_overrides(engines[0])},
        collector=recipe["kind"],
        seed=recipe.get("seed"),
        recipe=recipe,
        sources=[
            {
                **{k: v for k, v in dataset.identity().items() if k != "path"},
                "engine": dataset.provenance.engine_text,
            }
            for dataset in datasets
        ],
        origins=origins,
        complete=all(source.complete for source in sources),
    )
