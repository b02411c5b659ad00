"""Named datasets of the team's tasks: how each is made, and what it has to be.

A recipe names everything that its bytes depend on. ``datasets/recipes.json`` keeps the
SHA-256 of what it gave: who builds it with the same versions gets the same.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import marl_mm
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.declared import as_record
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import read_json
from marl_mm.registry import Registry
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.runs.settings import with_values
from marl_mm.runs.sources import Datasets, Notify, Source, silence
from marl_mm.sim.config import engine_of, engine_overrides
from marl_mm.versions import engine_text, versions

RECORD = Path(marl_mm.__file__).parent / "datasets" / "recipes.json"
"""File of what the recipes gave, by name."""

AXES = {
    "expert": "the script, and only what reaches the goal",
    "noisy": "the script with noise that stays for a while, successes and failures",
    "explore": "much slow noise: 5 to 10 % reach the goal by chance",
    "rare": "noise that leaves 2 to 5 % of the episodes to reach the goal",
    "one-bad": "one agent of the team acts at random, another one in each episode",
    "conventions": "each episode by one of the task's conventions",
    "stitch": "the script on halves of the way, for tests on the whole of it",
    "narrow": "the script on the easy level, for tests on the others",
}
"""What is asked of algorithms by each kind of data, by its name."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """A named dataset."""

    axis: str
    """Kind of data, of ``AXES``."""

    source: Source
    """Collector, task, steps, seed and engine."""

    @property
    def name(self) -> str:
        """Name, such as quiet-zone-noisy."""
        folder, kind = self.source.name.split("/")[1:]
        return f"{folder}-{kind.removesuffix('-v0')}"

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all that the dataset depends on, but for versions of packages."""
        source = self.source
        task = make_task(source.task, engine_overrides(source.engine))
        made_of = {
            **{k: v for k, v in asdict(source).items() if k != "settings"},
            "config": as_record(source.config),
            "task_config": config_dict(task),
        }
        text = json.dumps(made_of, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


RECIPES: Registry[Recipe] = Registry("recipe", [], of=Recipe)
"""All recipes by name."""


def _add(task: str, axis: str, steps: int, **settings: Any) -> None:
    kind, *_ = task.split("-")
    folder = "".join(f"-{c.lower()}" if c.isupper() else c for c in kind).strip("-")
    scripted = axis in ("expert", "stitch", "narrow")
    collector = "scripted" if scripted else "varied"
    source = Source(
        collector,
        task,
        steps,
        settings=settings,
        name=f"marl_mm/{folder}/{axis}-v0",
        engine="mujoco",
    )
    recipe = Recipe(axis=axis, source=source)
    RECIPES.add(recipe.name, recipe)


_SLOW = 0.8
"""Share of noise that stays, of noise that is slow."""

_NOISES: Mapping[str, tuple[float, float, float]] = {
    "QuietZone": (0.4, 0.7, 0.75),
    "Gate": (0.1, 0.18, 0.15),
    "Tray": (0.1, 0.22, 0.16),
    "MovingReach": (0.2, 0.3, 0.26),
}
"""Noise of noisy, explore and rare, in halves of the actions' ranges: slow but for the
last."""

for _kind, (_noisy, _explore, _rare) in _NOISES.items():
    _add(f"{_kind}-v0", "expert", 10_000)
    _add(f"{_kind}-v0", "noisy", 20_000, noise=_noisy, noise_memory=_SLOW)
    _add(f"{_kind}-v0", "explore", 20_000, noise=_explore, noise_memory=_SLOW)
    _add(f"{_kind}-v0", "rare", 20_000, noise=_rare)
    _add(f"{_kind}-v0", "one-bad", 20_000, one_random=True)
    _add(f"{_kind}-easy-v0", "narrow", 10_000)
for _kind in ("QuietZone", "Gate"):
    _add(f"{_kind}-halves-v0", "stitch", 10_000)
_add("Bar-v0", "expert", 10_000)
_add("Bar-v0", "conventions", 10_000, any_convention=True)
_add("Bar-v0", "noisy", 10_000, noise=0.06, noise_memory=_SLOW, any_convention=True)
_add("Bar-v0", "one-bad", 10_000, one_random=True)
_add("Course-v0", "expert", 10_000)
_add("Course-v0", "noisy", 10_000, noise=0.05)


@dataclass(frozen=True)
class Built:
    """A dataset that was built, beside what is on record."""

    recipe: Recipe
    """The recipe."""

    dataset: Dataset
    """The dataset."""

    recorded: Mapping[str, Any] | None
    """What is on record; None without a record."""

    @property
    def row(self) -> dict[str, Any]:
        """Numbers of the dataset, as they are recorded."""
        arrays, record = self.dataset.arrays, self.dataset.metadata["marl_mm"]
        return {
            "recipe": self.recipe.fingerprint,
            "engine": engine_text(self.recipe.source.engine or "bullet"),
            "steps": arrays.steps,
            "episodes": len(arrays),
            "success": float(arrays.successes().mean()),
            "data_sha256": record["data_sha256"],
        }

    @property
    def differs(self) -> tuple[str, ...]:
        """Names of the numbers that are not those on record."""
        row, recorded = self.row, self.recorded or {}
        return tuple(name for name, value in recorded.items() if row[name] != value)

    @property
    def verdict(self) -> str:
        """Whether it is what is on record, in words."""
        if self.recorded is None:
            return "not on record yet"
        if not self.differs:
            return "the dataset on record, to the bit"
        return (
            f"not the dataset on record: {', '.join(self.differs)} differ; that was "
            f"made with {self.recorded['engine']}, this one with {self.row['engine']}, "
            "and other processors may give other last bits"
        )


def build(
    name: str,
    *,
    workers: int = 1,
    progress: Bar = silent_bar,
    notify: Notify = silence,
) -> Built:
    """Build a named dataset below ``$MINARI_DATASETS_PATH``; one that is there is read.

    Args:
        name: Name of a recipe, see ``RECIPES``.
        workers: Processes that collect; the dataset does not depend on their number.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        notify: Callback for messages to the user.

    Raises:
        UsageError: If there is no such recipe.
        OtherConfigError: If another dataset has its id.
        KeyboardInterrupt: After Ctrl-C; the same call goes on.
    """
    recipe = RECIPES.get(name)
    datasets = Datasets(workers=workers, notify=notify, bar=progress)
    return Built(recipe, datasets.make(recipe.source), recorded().get(name))


def recorded() -> dict[str, dict[str, Any]]:
    """What the recipes gave, by name."""
    rows: dict[str, dict[str, Any]] = json.loads(RECORD.read_text())
    return rows


def catalogue_rows() -> list[dict[str, Any]]:
    """A row per recipe: task, kind of data, and the numbers on record."""
    known = recorded()
    rows = []
    for name, recipe in RECIPES.items():
        source, record = recipe.source, known.get(name, {})
        rows.append(
            {
                "name": name,
                "id": source.name,
                "task": source.task,
                "data": AXES[recipe.axis],
                "engine": record.get("engine", source.engine),
                "steps": record.get("steps", source.steps),
                "episodes": record.get("episodes"),
                "success": record.get("success"),
                "data_sha256": record.get("data_sha256"),
            }
        )
    return rows


def rebuild(
    card: str | Path, *, workers: int = 1, progress: Bar = silent_bar
) -> tuple[str, str]:
    """Collect a card's dataset again, elsewhere, and throw it away.

    Args:
        card: File ``card.json`` of a collected dataset.
        workers: Processes that collect.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Returns:
        SHA-256 of the data on the card, and of those that were collected now.

    Raises:
        DatasetError: If the card is not of a collection, or cannot be read.
    """
    values = read_json(Path(card), DatasetError)
    made_of, expected = values.get("made_of"), values.get("data_sha256")
    if not (isinstance(made_of, Mapping) and isinstance(expected, str)):
        raise DatasetError(
            f"{card} does not say what its dataset is made of: only collected datasets "
            "can be rebuilt, by cards that `marl-mm datasets show` has kept"
        )
    known = {"task", "collector", "collector_config", "overrides", "seed", "steps"}
    if missing := sorted(known - made_of.keys()):
        raise DatasetError(f"{card} lacks {', '.join(missing)} in made_of")
    collector, overrides = made_of["collector"], made_of["overrides"]
    default = COLLECTORS.get(collector).config()
    with TemporaryDirectory() as folder:
        location = Location(str(values.get("id")), Path(folder, "rebuilt"))
        collecting = Collecting(
            steps=made_of["steps"],
            seed=made_of["seed"],
            task=made_of["task"],
            engine=engine_of(overrides),
            max_steps=overrides.get("max_steps"),
            workers=workers,
        )
        config = with_values(default, made_of["collector_config"])
        collect_dataset(location, collector, config, collecting, bar=progress)
        return expected, str(read_metadata(location)["marl_mm"]["data_sha256"])


def differing_packages(card: str | Path) -> Sequence[str]:
    """Packages whose versions are not those on a card, with both versions."""
    values = read_json(Path(card), DatasetError)
    packages = values.get("made_of", {}).get("packages", {})
    now = versions()
    return [
        f"{name} {then}, here {now.get(name)}"
        for name, then in packages.items()
        if now.get(name) != then
    ]


def refuse_unknown(names: Sequence[str]) -> None:
    """Raise for names that are no recipe's.

    Raises:
        UsageError: For the first of them, with the nearest name, or without any.
    """
    if not names:
        raise UsageError(f"name a recipe: {', '.join(RECIPES.names())}")
    for name in names:
        RECIPES.get(name)
