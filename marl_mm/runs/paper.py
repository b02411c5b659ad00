"""The datasets of the paper's Tables 4 and 5, by name."""

from collections.abc import Iterator
from dataclasses import dataclass

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.recipe import Part, mix, write_mix
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collect_resume import begun_with
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.runs.settings import check_seed
from marl_mm.workers import Executor

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
    call goes on after an interruption. good-60k begins with good-30k.
    """

    scale: float = 1.0
    """Share of the paper's steps, to see that everything works."""

    seed: int = 0
    """Seed of all datasets."""

    workers: int = 1
    """Processes; the datasets do not depend on their number."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster."""

    overwrite: bool = False
    """Replace those that are damaged, of another seed or of a larger scale."""


def collect_paper(paper: Paper, bar: Bar = silent_bar) -> Iterator[Dataset]:
    """Make what is missing of the paper's datasets; each is yielded when it is there.

    Args:
        paper: Size and seed of the datasets.
        bar: Begins a bar of progress.

    Raises:
        UsageError: If there are others of these names, which may not be replaced.
        KeyboardInterrupt: After Ctrl-C; the same call goes on.
    """
    check_seed(paper.seed)
    if not 0.0 < paper.scale <= 100.0:
        raise UsageError(f"`scale` is {paper.scale}, expected a share such as 0.01")
    for name in (*COLLECTED, *MIXED):  # before any work is done
        _fits(paper_location(name), _steps(name, paper), paper)
    for name in (*COLLECTED, *MIXED):
        location = paper_location(name)
        if name in COLLECTED:
            _collect(name, location, paper, bar)
        else:
            _mix(name, location, paper)
        yield load_dataset(location)


def paper_location(name: str) -> Location:
    """Location of a dataset of the paper."""
    return locate(f"marl_mm/reach/{name}-v0")


def _collect(name: str, location: Location, paper: Paper, bar: Bar) -> None:
    collector, _ = COLLECTED[name]
    steps = _steps(name, paper)
    begun = location.folder.exists() or location.working.exists()
    fits = _fits(location, steps, paper)
    options = Collecting(
        steps=steps,
        seed=paper.seed,
        workers=paper.workers,
        executor=paper.executor,
        resume=begun and fits,
        overwrite=begun and not fits,
    )
    first = paper_location("good-30k") if name == "good-60k" else None
    collection = collect_dataset(
        location, collector, COLLECTORS.get(collector).config(), options, first, bar
    )
    if not collection.complete:
        raise KeyboardInterrupt(f"stopped in {name}; the same call goes on there")


def _mix(name: str, location: Location, paper: Paper) -> None:
    """Mix what there is, unless the mix is of just that already.

    A mix follows its sources: one of shorter ones gives way.
    """
    parts = [
        Part(load_dataset(paper_location(source)), _scaled(steps, paper))
        for source, steps in MIXED[name].items()
    ]
    recipe = mix(parts, paper.seed)
    if location.folder.exists():
        try:
            known = Provenance.from_json(read_metadata(location)["marl_mm"])
            mine = recipe.provenance
            if (known.recipe, known.sources) == (mine.recipe, mine.sources):
                return
        except DatasetError:  # and may be replaced
            pass
    write_mix(location, recipe, overwrite=True)


def _fits(location: Location, steps: int, paper: Paper) -> bool:
    """Whether a dataset that is there can be kept and gone on with.

    Raises:
        UsageError: If it cannot, and may not be replaced.
        DatasetError: If it is damaged, and may not be replaced.
    """
    try:
        there = begun_with(location)
    except DatasetError:
        if paper.overwrite:
            return False
        raise
    if there is None:
        return True
    seed, asked = there.seed, there.steps_asked or 0
    if there.recipe is not None:
        asked = sum(there.recipe.get("steps", {}).values())
    if seed == paper.seed and asked <= steps:
        return True
    if not paper.overwrite:
        raise UsageError(
            f"{location.id} is of seed {seed} and {asked} steps, now asked for seed "
            f"{paper.seed} and {steps}: add `overwrite=True` to replace it"
        )
    return False


def _steps(name: str, paper: Paper) -> int:
    """Steps that a dataset is asked to have, at least."""
    if name in COLLECTED:
        return _scaled(COLLECTED[name][1], paper)
    return sum(_scaled(steps, paper) for steps in MIXED[name].values())


def _scaled(steps: int, paper: Paper) -> int:
    return max(1, round(paper.scale * steps))
