"""The datasets of the paper's Tables 4 and 5, by name."""

import json
from dataclasses import dataclass, field

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.commands.collect_dataset import (
    CollectOptions,
    collect_dataset,
)
from marl_mm.commands.collect_resume import begun_with
from marl_mm.commands.options import check_seed
from marl_mm.datasets.card import card_text, keep_card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.recipe import Part, mix, write_mix
from marl_mm.datasets.storage import read_metadata
from marl_mm.errors import DatasetError, UsageError
from marl_mm.workers import Executor, available_cores

COLLECTED: dict[str, tuple[str, int]] = {
    "good-30k": ("pretrained", 30_000),
    "good-60k": ("pretrained", 60_000),
    "pd-30k": ("pd", 30_000),
    "random-10k": ("random", 10_000),
    "medium-5k": ("medium", 5_000),
}
"""Who acts, and how many steps (paper, Sec. 5.4.2)."""

MIXED = {
    "mix-5k-random-5k-medium-20k-good": {
        "random-10k": 5_000,
        "medium-5k": 5_000,
        "good-30k": 20_000,
    },
    "mix-10k-random-20k-good": {"random-10k": 10_000, "good-30k": 20_000},
}
"""Steps of each source (paper, Table 4)."""


@dataclass(frozen=True)
class Paper:
    """Make what is missing of the paper's datasets, marl_mm/reach/NAME-v0.

    good-30k, good-60k, pd-30k, random-10k, medium-5k and the mixes of Table 4. The same
    command goes on after an interruption. good-60k begins with good-30k.
    """

    scale: float = 1.0
    """Share of the paper's steps, to see that everything works."""

    seed: int = 0
    """Of all datasets."""

    workers: int = field(default_factory=available_cores)
    """Processes; the datasets do not depend on it."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster."""

    resume: bool = False
    """Go on after an interruption: it does so anyway."""

    overwrite: bool = False
    """Replace those that are damaged, of another seed or of a larger scale."""

    json: bool = False
    """Print the cards as JSON."""


def collect_paper(command: Paper) -> None:
    """Make what is missing of the paper's datasets, and print their cards."""
    check_seed(command.seed)
    if not 0.0 < command.scale <= 100.0:
        raise UsageError(f"--scale is {command.scale}, expected a share such as 0.01")
    for name in (*COLLECTED, *MIXED):  # before any work is done
        _fits(paper_location(name), _steps(name, command), command)
    cards = []
    for name in (*COLLECTED, *MIXED):
        location = paper_location(name)
        if name in COLLECTED:
            _collect(name, location, command)
        else:
            _mix(name, location, command)
        cards.append(keep_card(load_dataset(location)))
        if not command.json:
            print(card_text(cards[-1]), end="\n\n", flush=True)
    if command.json:
        print(json.dumps(cards, indent=2))


def paper_location(name: str) -> Location:
    """Where one of the paper's datasets is."""
    return locate(f"marl_mm/reach/{name}-v0")


def _collect(name: str, location: Location, command: Paper) -> None:
    collector, _ = COLLECTED[name]
    steps = _steps(name, command)
    begun = location.folder.exists() or location.working.exists()
    fits = _fits(location, steps, command)
    options = CollectOptions(
        steps=steps,
        seed=command.seed,
        workers=command.workers,
        executor=command.executor,
        resume=begun and fits,
        overwrite=begun and not fits,
    )
    first = paper_location("good-30k") if name == "good-60k" else None
    collection = collect_dataset(
        location, collector, COLLECTORS.get(collector).config(), options, first
    )
    if not collection.complete:
        raise KeyboardInterrupt(f"stopped in {name}; the same command goes on there")


def _mix(name: str, location: Location, command: Paper) -> None:
    """Mix what there is, unless the mix is of just that already.

    A mix follows its sources: one of shorter ones gives way.
    """
    parts = [
        Part(load_dataset(paper_location(source)), _scaled(steps, command))
        for source, steps in MIXED[name].items()
    ]
    recipe = mix(parts, command.seed)
    if location.folder.exists():
        try:
            known = Provenance.from_json(read_metadata(location)["marl_mm"])
            mine = recipe.provenance
            if (known.recipe, known.sources) == (mine.recipe, mine.sources):
                return
        except DatasetError:  # and may be replaced
            pass
    write_mix(location, recipe, overwrite=True)


def _fits(location: Location, steps: int, command: Paper) -> bool:
    """Whether what is there can be kept and gone on with.

    Raises:
        UsageError: If it cannot, and may not be replaced.
        DatasetError: If it is damaged, and may not be replaced.
    """
    try:
        there = begun_with(location)
    except DatasetError:
        if command.overwrite:
            return False
        raise
    if there is None:
        return True
    seed, asked = there.seed, there.steps_asked or 0
    if there.recipe is not None:
        asked = sum(there.recipe.get("steps", {}).values())
    if seed == command.seed and asked <= steps:
        return True
    if not command.overwrite:
        raise UsageError(
            f"{location.id} is of seed {seed} and {asked} steps, now asked for seed "
            f"{command.seed} and {steps}: add --overwrite to replace it"
        )
    return False


def _steps(name: str, command: Paper) -> int:
    """Steps that a dataset is asked to have, at least."""
    if name in COLLECTED:
        return _scaled(COLLECTED[name][1], command)
    return sum(_scaled(steps, command) for steps in MIXED[name].values())


def _scaled(steps: int, command: Paper) -> int:
    return max(1, round(command.scale * steps))
