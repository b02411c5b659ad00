"""Datasets of other datasets' episodes, and of files that others wrote."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

from marl_mm.datasets.card import keep_card
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.importing import read_foreign
from marl_mm.datasets.location import Location, locate, text_of
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.selection import (
    Condition,
    Part,
    filtered,
    mix,
    split,
    write_selection,
)
from marl_mm.datasets.storage import alone, refuse_foreign, write_alone
from marl_mm.envs.registry import make_task
from marl_mm.episode import IMPORTED
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing, refuse_input
from marl_mm.runs.settings import check_seed, is_whole, with_settings
from marl_mm.sim.config import ENGINES, RECORDED_ENGINE, Engine, engine_overrides
from marl_mm.temporary import remove
from marl_mm.words import refuse_control_characters

Named = Dataset | str | Path
"""A dataset, its id or its path."""


def mix_datasets(
    parts: Mapping[str, int] | Iterable[tuple[Named, int]],
    out: str | Path,
    *,
    seed: int = 0,
    overwrite: bool = False,
) -> Dataset:
    """Draw steps from each of several datasets at random, as whole episodes.

    Args:
        parts: Datasets and how many steps are drawn from each, at least, such as
            ``{"good": 20_000, "random": 5_000}``, or pairs of the two.
        out: Id or path of the mix.
        seed: Seed of the draw.
        overwrite: Whether what exists may be replaced.

    Raises:
        UsageError: If a setting makes no sense, or the datasets do not go together.
        OutputExistsError: If there is a dataset, and it may not be replaced.
    """
    check_seed(seed)
    try:
        pairs = dict(parts).items() if isinstance(parts, Mapping) else [*parts]
        drawn = [(dataset, steps) for dataset, steps in pairs]
    except (TypeError, ValueError):
        drawn = []
    if not drawn:
        raise UsageError(f"`parts` is {parts!r:.80}, expected datasets and their steps")
    for dataset, steps in drawn:
        named = dataset.location.name if isinstance(dataset, Dataset) else dataset
        if not is_whole(steps) or steps < 1:
            raise UsageError(
                f"{steps!r:.40} steps of {named} are asked for, expected a whole "
                "number >= 1"
            )
    read = [Part(_read(dataset), steps) for dataset, steps in drawn]
    location = _free(out, overwrite, *(part.dataset.location.folder for part in read))
    write_selection(location, mix(read, seed), overwrite)
    return _kept(location)


def split_dataset(
    dataset: Named,
    *,
    out: str | Path | None = None,
    share: float = 0.8,
    seed: int = 0,
    overwrite: bool = False,
) -> tuple[Dataset, Dataset]:
    """Divide a dataset's episodes at random into OUT-first-v0 and OUT-rest-v0.

    Args:
        dataset: Dataset, id or path.
        out: Beginning of the new ids; default the dataset's own.
        share: Share of the episodes that go into the first dataset.
        seed: Seed of the draw.
        overwrite: Whether what exists may be replaced.

    Raises:
        UsageError: If a setting makes no sense, or there is only one episode.
        OutputExistsError: If there is one of the two, and it may not be replaced.
    """
    check_seed(seed)
    source = _read(dataset)
    if not isinstance(out, str | Path | None):
        raise UsageError(f"`out` is {out!r:.80}, expected the beginning of a name")
    stem = text_of(source.location.name if out is None else out).removesuffix("-v0")
    if stem.split("/")[-1] in ("", ".", ".."):
        raise UsageError(f"`out` is {out!r}, expected the beginning of a name")
    names = [f"{stem}-{part}-v0" for part in ("first", "rest")]
    first, rest = (_free(name, overwrite, source.location.folder) for name in names)
    recipes = split(source, share, seed)
    with alone(first), alone(rest):
        if rest.folder.exists():  # never beside the first half of another split
            remove(rest.folder)
    for location, recipe in zip((first, rest), recipes, strict=True):
        write_selection(location, recipe, overwrite)
    return _kept(first), _kept(rest)


def filter_dataset(
    dataset: Named,
    out: str | Path,
    *,
    outcome: Literal["reached", "missed"] | None = None,
    direction: Literal["forward", "backward"] | None = None,
    min_return: float | None = None,
    max_return: float | None = None,
    overwrite: bool = False,
) -> Dataset:
    """Keep the episodes that meet all conditions.

    Args:
        dataset: Dataset, id or path.
        out: Id or path of the new dataset.
        outcome: Only episodes that reached their goal, or only those that did not.
        direction: Only episodes whose goal is ahead, or behind.
        min_return: Least sum of rewards.
        max_return: Largest sum of rewards.
        overwrite: Whether what exists may be replaced.

    Raises:
        UsageError: If there is no condition, or no episode meets them.
        OutputExistsError: If there is a dataset, and it may not be replaced.
    """
    if outcome not in (None, "reached", "missed"):
        raise UsageError(f"`outcome` is {outcome!r:.40}, expected reached or missed")
    asked = {
        "success": None if outcome is None else outcome == "reached",
        "direction": direction,
        "min_return": min_return,
        "max_return": max_return,
    }
    condition = with_settings("filter", Condition(), asked)
    source = _read(dataset)
    location = _free(out, overwrite, source.location.folder)
    write_selection(location, filtered(source, condition), overwrite)
    return _kept(location)


def import_dataset(
    file: str | Path,
    out: str | Path,
    *,
    task: str | None = None,
    engine: Engine | None = None,
    overwrite: bool = False,
) -> Dataset:
    """Take a Minari dataset or an HDF5 file of one's own.

    The place where its episodes were collected is not kept: nothing can replay them.

    Args:
        file: HDF5 file, or folder of a Minari dataset.
        out: Id or path of the new dataset.
        task: Registered name of the task; default the file's, or Reach-v0 without one.
        engine: Engine of the episodes; default the file's own, or PyBullet without one.
        overwrite: Whether what exists may be replaced.

    Raises:
        UsageError: If there is no such file, its layout is not the task's, or it is of
            another engine.
        DatasetError: If it cannot be read, or holds impossible values.
        OutputExistsError: If there is a dataset, and it may not be replaced.
    """
    if not isinstance(file, str | Path):
        raise UsageError(f"`file` is {file!r:.80}, expected a file or a folder")
    refuse_control_characters("the file's name", Path(file).name)
    if engine not in (None, *ENGINES):
        raise UsageError(f"`engine` is {engine!r}, expected {' or '.join(ENGINES)}")
    location = _free(out, overwrite, Path(file))
    foreign = read_foreign(Path(file), location.id, task)
    named = foreign.engine if foreign.engine in ENGINES else None
    if engine and named not in (None, engine):
        raise UsageError(
            f"{file} is of engine {named}, `engine` is {engine!r}: leave it out, as "
            "the file names its own"
        )
    if engine is None and foreign.engine is not None and named is None:
        raise UsageError(
            f"{file} is of engine {foreign.engine!r:.60}, expected "
            f"{' or '.join(ENGINES)}: give `engine`"
        )
    longest = max(make_task(foreign.task).max_steps, int(foreign.arrays.lengths.max()))
    engine = engine or named or RECORDED_ENGINE
    provenance = Provenance(
        task=foreign.task,
        overrides={"max_steps": longest, **engine_overrides(engine)},
        collector=IMPORTED,
        origins={location.id: Origin(file=Path(file).name)},
    )
    write_alone(location, foreign.arrays, provenance, overwrite)
    return _kept(location)


def _read(dataset: Named) -> Dataset:
    return dataset if isinstance(dataset, Dataset) else load_dataset(dataset)


def _free(out: str | Path, overwrite: bool, *made_of: Path) -> Location:
    if not isinstance(out, str | Path):
        raise UsageError(f"`out` is {out!r:.80}, expected an id or a path")
    location = locate(text_of(out))
    refuse_foreign(location)
    refuse_existing(location.folder, overwrite)
    refuse_input(location.folder, made_of)
    return location


def _kept(location: Location) -> Dataset:
    """The dataset that was written, with its card beside it."""
    dataset = load_dataset(location)
    keep_card(dataset)
    return dataset
