"""Datasets that are collected again from their cards, to compare the data."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.card import kept_card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import ID, Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.errors import DatasetError, UnknownDatasetError, UsageError
from marl_mm.plugins import record
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import check_kind, read_json
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.runs.settings import (
    as_path,
    check_positive,
    check_seed,
    flat,
    with_settings,
)
from marl_mm.sim.config import ENGINES, RECORDED_ENGINE, engine_overrides
from marl_mm.versions import versions

_MADE_OF: Mapping[str, Any] = {
    "task": str,
    "collector": str,
    "collector_config": dict[str, Any],
    "overrides": dict[str, Any],
    "seed": int,
    "steps": int,
    "packages": dict[str, str],
}
"""Types of what a card says that its dataset is made of."""

_ACTED: Mapping[str, Any] = {"weights": str, "plugins": dict[str, str]}
"""Types of what acted, where that was a learnt agent or is of plug-ins."""


@dataclass(frozen=True)
class Card:
    """What a card says, checked."""

    id: str
    """Id of the dataset, which stands in its data."""

    data_sha256: str
    """SHA-256 of the data file."""

    collector: str
    """Registered name of the collector."""

    config: Any
    """Settings of the collector."""

    collecting: Collecting
    """Task, engine, seed, steps and longest episode."""

    packages: Mapping[str, str]
    """Versions by package."""

    acted: Mapping[str, Any] = field(default_factory=dict)
    """Fingerprint of the learnt agent and SHA-256 of plug-ins, where there are some."""

    @property
    def differing_packages(self) -> Sequence[str]:
        """Packages whose versions are others here, with both versions."""
        now = versions()
        return [
            f"{name} {then}, here {now.get(name)}"
            for name, then in self.packages.items()
            if now.get(name) != then
        ]


def read_card(card: str | Path) -> Card:
    """A card of a collected dataset.

    Args:
        card: File ``card.json``, or id, name or path of a dataset, whose card it is.

    Raises:
        UnknownDatasetError: If there is neither.
        DatasetError: If the card is not of a collection, or says what makes no sense.
    """
    path = as_path(card, "card", "a card or a dataset")
    if path.suffix == ".json" and not path.exists():
        raise UnknownDatasetError(f"there is no {card}, expected a card or a dataset")
    if path.suffix == ".json" or path.is_file():
        values = read_json(path, DatasetError)
    else:
        values = kept_card(load_dataset(card))
    check_kind(values, dict[str, Any], str(card), DatasetError)
    if values.get("complete") is False:
        raise DatasetError(
            f"{card} is of a collection that was stopped: finish it first, with "
            "marl-mm collect --resume"
        )
    made_of, expected = values.get("made_of"), values.get("data_sha256")
    if not (isinstance(made_of, Mapping) and isinstance(expected, str)):
        raise DatasetError(
            f"{card} does not say what its dataset is made of: only collected datasets "
            "can be rebuilt, by cards that marl-mm datasets show or build has kept"
        )
    name = values.get("id")
    if not isinstance(name, str) or not ID.fullmatch(name):
        raise DatasetError(f"{card}: id is {name!r:.80}, expected a dataset's id")
    where = f"{card}: made_of"
    _refuse_other_keys(made_of, (*_MADE_OF, *_ACTED), where)
    if missing := sorted(_MADE_OF.keys() - made_of.keys()):
        raise DatasetError(
            f"{card} lacks {', '.join(missing)} in made_of: keep the card anew with "
            "marl-mm datasets show"
        )
    acted = {key: made_of[key] for key in _ACTED if key in made_of}
    for key, kind in (*_MADE_OF.items(), *((k, _ACTED[k]) for k in acted)):
        _check_value(made_of[key], kind, f"{where}: {key}")
    try:
        collecting = _collecting(made_of, where)
        config = _config(made_of)
    except UsageError as error:  # of what was received, not of what was typed
        text = str(error).replace("`", "")  # which names options
        raise DatasetError(f"{card}: {text}") from error
    collector, packages = made_of["collector"], made_of["packages"]
    return Card(name, expected, collector, config, collecting, packages, acted)


def rebuild(
    card: str | Path | Card, *, workers: int = 1, progress: Bar = silent_bar
) -> tuple[str, str]:
    """Collect a card's dataset again, elsewhere, and throw it away.

    Args:
        card: Card, or what ``read_card`` takes.
        workers: Processes that collect.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Returns:
        SHA-256 of the data on the card, and of those that were collected now.

    Raises:
        UnknownDatasetError: If there is no such card or dataset.
        DatasetError: If the card is not of a collection, says what makes no sense, or
            names an agent or plug-in that is another here.
        KeyboardInterrupt: After Ctrl-C.
    """
    card = card if isinstance(card, Card) else read_card(card)
    _refuse_others(card)
    with TemporaryDirectory() as folder:
        location = Location(card.id, Path(folder, "rebuilt"))
        collecting = replace(card.collecting, workers=workers)
        done = collect_dataset(
            location, card.collector, card.config, collecting, bar=progress
        )
        if not done.complete:
            raise KeyboardInterrupt(
                "stopped before the data were whole: nothing is kept"
            )
        made = read_metadata(location)["marl_mm"]
    return card.data_sha256, str(made["data_sha256"])


def _refuse_others(card: Card) -> None:
    """Raise a DatasetError for a card whose agent or plug-in is another here."""
    collecting = card.collecting
    steps = {"max_steps": collecting.max_steps} if collecting.max_steps else {}
    task = make_task(collecting.task, steps | engine_overrides(collecting.engine))
    policy = COLLECTORS.get(card.collector).policy(card.config, task)
    origins = COLLECTORS.origin(card.collector), TASKS.origin(collecting.task)
    here = {"weights": policy.describe().get("weights"), "plugins": record(*origins)}
    for name, value in card.acted.items():
        if here[name] != value:
            raise DatasetError(
                f"{card.id} was collected with {name} {value}, here {here[name]}: "
                "that agent or plug-in is another"
            )


def _collecting(made_of: Mapping[str, Any], where: str) -> Collecting:
    """Settings of the collection."""
    overrides = made_of["overrides"]
    where = f"{where}: overrides"
    _refuse_other_keys(overrides, ("max_steps", "simulation"), where)
    simulation = overrides.get("simulation", {})
    _check_value(simulation, dict[str, Any], f"{where}: simulation")
    _refuse_other_keys(simulation, ("engine",), f"{where}: simulation")
    engine = simulation.get("engine", RECORDED_ENGINE)
    if engine not in (*ENGINES,):
        choices = ", ".join(ENGINES)
        raise DatasetError(f"{where}: engine is {engine!r:.60}, expected of {choices}")
    max_steps = overrides.get("max_steps")
    if max_steps is not None:
        _check_value(max_steps, int, f"{where}: max_steps")
        check_positive(max_steps=max_steps)
    check_positive(steps=made_of["steps"])
    check_seed(made_of["seed"])
    make_task(made_of["task"], overrides)
    return Collecting(
        steps=made_of["steps"],
        seed=made_of["seed"],
        task=made_of["task"],
        engine=engine,
        max_steps=max_steps,
    )


def _config(made_of: Mapping[str, Any]) -> Any:
    """Settings of the collector."""
    collector = made_of["collector"]
    settings = {
        name: tuple(value) if isinstance(value, list) else value  # as JSON has them
        for name, value in flat(made_of["collector_config"]).items()
    }
    default = COLLECTORS.get(collector).config()
    return with_settings(f"collector {collector}", default, settings)


def _refuse_other_keys(
    values: Mapping[str, Any], known: Iterable[str], where: str
) -> None:
    known = tuple(known)
    for name in values:
        if name not in known:
            raise DatasetError(
                f"{where} has {name!r:.60}, which is not rebuilt, expected "
                f"{', '.join(known)} only"
            )


def _check_value(value: Any, kind: Any, where: str) -> None:
    if kind is int and isinstance(value, bool):
        raise DatasetError(f"{where}: {value} is not a whole number")
    check_kind(value, kind, where, DatasetError)
