"""Named datasets of the team's tasks: how each is made, and what it has to be.

A recipe names everything that its bytes depend on. ``datasets/recipes.json`` keeps the
SHA-256 of what it gave: who builds it with the same versions gets the same.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from marl_mm.datasets import shipped
from marl_mm.datasets.card import keep_card
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.named import AXES, RECORD
from marl_mm.declared import as_record
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.errors import UsageError
from marl_mm.progress import Bar, silent_bar
from marl_mm.registry import Registry
from marl_mm.runs.making import Datasets, Notify, silence
from marl_mm.runs.sources import Source, task_folder
from marl_mm.sim.config import engine_overrides
from marl_mm.versions import engine_text


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


_DECIDING = ("python", "mujoco-core", "numba", "numpy")
"""Packages whose versions decide a dataset's bits."""

RECIPES: Registry[Recipe] = Registry("recipe", [], of=Recipe)
"""All recipes by name."""


def _add(task: str, axis: str, steps: int, **settings: Any) -> None:
    folder = task_folder(task.split("-")[0])
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
            "engine": engine_text(
                self.recipe.source.engine or "bullet", record["packages"]
            ),
            "steps": arrays.steps,
            "episodes": len(arrays),
            "success": float(arrays.successes().mean()),
            "packages": _versions_text(record["packages"]),
            "data_sha256": record["data_sha256"],
        }

    @property
    def differs(self) -> tuple[str, ...]:
        """Names of the numbers that are not those on record, but for versions."""
        row, recorded = self.row, self.recorded or {}
        names = (name for name in recorded if name != "packages")
        return tuple(name for name in names if row[name] != recorded[name])

    @property
    def verdict(self) -> str:
        """Whether it is what is on record, in words."""
        if self.recorded is None:
            return "not on record yet"
        if not self.differs:
            return "the dataset on record, to the bit"
        return (
            f"not the dataset on record: {', '.join(self.differs)} differ; that was "
            f"made with {self.recorded['packages']}, this one with "
            f"{self.row['packages']}, and other code or another processor may give "
            "other bits"
        )


def build_dataset(
    name: str,
    *,
    workers: int = 1,
    progress: Bar = silent_bar,
    notify: Notify = silence,
) -> Built:
    """Build a named dataset below ``$MINARI_DATASETS_PATH``; one that is there is read.

    Its card is kept with it.

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
    dataset = datasets.make(recipe.source)
    keep_card(dataset)
    return Built(recipe, dataset, recorded().get(name))


def _versions_text(packages: Mapping[str, str]) -> str:
    """Versions of what computes an episode, in words."""
    return ", ".join(f"{name} {packages[name]}" for name in _DECIDING)


def recorded() -> dict[str, dict[str, Any]]:
    """What the recipes gave, by name."""
    rows: dict[str, dict[str, Any]] = json.loads(RECORD.read_text("utf-8"))
    return rows


def named_card(name: str) -> dict[str, Any]:
    """What a named dataset is made of, and what is on record of it.

    Raises:
        UsageError: If there is no such recipe.
    """
    recipe = RECIPES.get(name)
    source, record = recipe.source, recorded().get(name, {})
    return {
        "name": name,
        "id": source.name,
        "task": source.task,
        "axis": recipe.axis,
        "data": AXES[recipe.axis],
        "collector": source.collector,
        "settings": dict(source.settings),
        "seed": source.seed,
        "engine": record.get("engine", source.engine),
        "steps": record.get("steps", source.steps),
        "episodes": record.get("episodes"),
        "success": record.get("success"),
        "packages": record.get("packages"),
        "data_sha256": record.get("data_sha256"),
        "ships": source.name in shipped.IDS,
        "build": f"marl-mm datasets build {name}",
    }


def catalogue_rows() -> list[dict[str, Any]]:
    """A card per recipe, see ``named_card``."""
    return [named_card(name) for name in RECIPES.names()]


def refuse_unknown(names: Sequence[str]) -> None:
    """Raise for names that are no recipe's.

    Raises:
        UsageError: For the first of them, with the nearest name, or without any.
    """
    if not names:
        raise UsageError(f"name a recipe: {', '.join(RECIPES.names())}")
    for name in names:
        RECIPES.get(name)
