"""Commands that make datasets of other datasets' episodes."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from marl_mm.commands.options import task_help
from marl_mm.commands.output import read_dataset, show
from marl_mm.datasets.card import card_text
from marl_mm.datasets.dataset import Dataset
from marl_mm.errors import UsageError
from marl_mm.runs.deriving import (
    filter_dataset,
    import_dataset,
    mix_datasets,
    split_dataset,
)
from marl_mm.sim.config import Engine

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
    if not parts:
        raise UsageError("name at least one DATASET:STEPS")
    drawn = [_part(text) for text in parts]
    _tell([mix_datasets(drawn, out, seed=seed, overwrite=overwrite)], json)


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
    source = read_dataset(dataset)
    made = split_dataset(source, out=out, share=share, seed=seed, overwrite=overwrite)
    _tell([*made], json)


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
    made = filter_dataset(
        read_dataset(dataset),
        out,
        outcome=outcome,
        direction=direction,
        min_return=min_return,
        max_return=max_return,
        overwrite=overwrite,
    )
    _tell([made], json)


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
    made = import_dataset(file, out, task=task, engine=engine, overwrite=overwrite)
    _tell([made], json)


def _part(text: str) -> tuple[Dataset, int]:
    name, _, steps = text.rpartition(":")
    if not name or not steps.isdecimal():
        raise UsageError(f"{text!r} is no DATASET:STEPS, such as good:20000")
    return read_dataset(name), int(steps)


def _tell(made: list[Dataset], as_json: bool) -> None:
    cards = [dataset.card() for dataset in made]
    values = cards if len(cards) > 1 else cards[0]
    show(values, "\n\n".join(map(card_text, cards)), as_json)
