"""Commands that make datasets of other datasets' episodes."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from marl_mm.commands.options import task_help
from marl_mm.commands.output import read_dataset, show
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
from marl_mm.files import refuse_existing, refuse_input
from marl_mm.runs.settings import check_seed
from marl_mm.sim.config import Engine, engine_overrides

_TASK = task_help(
    'Task of the episodes: {}; default the file\'s attribute "task", or '
    "Reach-v0 without one."
)


def make_mix(
    parts: tyro.conf.Positional[tuple[str, ...]],
    *,
    out: str,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Draw steps from each of several datasets at random, as whole episodes.

    Args:
        parts: DATASET:STEPS, such as good:20000 medium:5000 random:5000.
        out: Id or path of the mix.
        seed: Seed of the draw.
        overwrite: Replace what exists.
        json: Print the new dataset's card as JSON.
    """
    check_seed(seed)
    if not parts:
        raise UsageError("name at least one DATASET:STEPS")
    read = [_part(text) for text in parts]
    location = _free(out, overwrite, *(p.dataset.location.folder for p in read))
    write_mix(location, mix(read, seed), overwrite)
    _tell([location], json)


def make_split(
    dataset: tyro.conf.Positional[str],
    *,
    out: str | None = None,
    share: float = 0.8,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Divide a dataset's episodes at random into OUT-first-v0 and OUT-rest-v0.

    Args:
        dataset: Id or path.
        out: Beginning of the new ids; default the dataset's own.
        share: Share of the episodes that go into the first dataset.
        seed: Seed of the draw.
        overwrite: Replace what exists.
        json: Print the new datasets' cards as JSON.
    """
    check_seed(seed)
    source = existing(dataset)
    stem = (out or source.name).removesuffix("-v0")
    if stem.split("/")[-1] in ("", ".", ".."):
        raise UsageError(f"--out is {out!r}, expected the beginning of a name")
    names = [f"{stem}-{part}-v0" for part in ("first", "rest")]
    locations = [_free(name, overwrite, source.folder) for name in names]
    recipes = split(read_dataset(source), share, seed)
    for location, recipe in zip(locations, recipes, strict=True):
        write_mix(location, recipe, overwrite)
    _tell(locations, json)


def make_filtered(
    dataset: tyro.conf.Positional[str],
    *,
    out: str,
    outcome: Literal["reached", "missed"] | None = None,
    direction: Literal["forward", "backward"] | None = None,
    min_return: float | None = None,
    max_return: float | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Keep the episodes that meet all conditions.

    Args:
        dataset: Id or path.
        out: Id or path of the new dataset.
        outcome: Only episodes that reached their goal, or only those that did not.
        direction: Only episodes whose goal is ahead, or behind.
        min_return: Least sum of rewards.
        max_return: Largest sum of rewards.
        overwrite: Replace what exists.
        json: Print the new dataset's card as JSON.
    """
    source = existing(dataset)
    location = _free(out, overwrite, source.folder)
    success = None if outcome is None else outcome == "reached"
    condition = Condition(success, direction, min_return, max_return)
    write_mix(location, filtered(read_dataset(source), condition), overwrite)
    _tell([location], json)


def make_imported(
    file: tyro.conf.Positional[Path],
    *,
    out: str,
    task: Annotated[str | None, _TASK] = None,
    engine: Engine | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Take a Minari dataset or an HDF5 file of your own.

    Minari's form with goal-dictionary observations: observation, achieved_goal,
    desired_goal, as in the task's layout. Or flat arrays: observations (n, d),
    actions (n, k), next_observations, rewards, terminals, timeouts; or what export
    writes per agent.
    The place where its episodes were collected is not kept: nothing can replay them.

    Args:
        file: HDF5 file, or folder of a Minari dataset.
        out: Id or path of the new dataset.
        task: Registered name of the task.
        engine: Engine of the episodes; default the file's own, or PyBullet without one.
        overwrite: Replace what exists.
        json: Print the new dataset's card as JSON.
    """
    location = _free(out, overwrite, file)
    foreign = read_foreign(file, location.id, task)
    longest = max(make_task(foreign.task).max_steps, int(foreign.arrays.lengths.max()))
    provenance = Provenance(
        task=foreign.task,
        overrides={"max_steps": longest, **engine_overrides(engine or foreign.engine)},
        collector=IMPORTED,
        origins={location.id: Origin(file=file.name)},
    )
    write_alone(location, foreign.arrays, provenance, overwrite)
    _tell([location], json)


def _free(name: str, overwrite: bool, *made_of: Path) -> Location:
    location = locate(name)
    refuse_foreign(location)
    refuse_existing(location.folder, overwrite)
    refuse_input(location.folder, made_of)
    return location


def _part(text: str) -> Part:
    name, _, steps = text.rpartition(":")
    if not name or not steps.isdecimal():
        raise UsageError(f"{text!r} is no DATASET:STEPS, such as good:20000")
    return Part(read_dataset(name), int(steps))


def _tell(locations: list[Location], as_json: bool) -> None:
    cards = [keep_card(load_dataset(location)) for location in locations]
    values = cards if len(cards) > 1 else cards[0]
    show(values, "\n\n".join(map(card_text, cards)), as_json)
