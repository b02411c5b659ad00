"""marl-mm verify: score a submission again."""

from dataclasses import asdict
from pathlib import Path

import tyro

from marl_mm.commands.options import CORES
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.errors import SubmissionError
from marl_mm.progress import progress_bars
from marl_mm.received import printable
from marl_mm.runs.verify import verify


@command
def main(
    folder: tyro.conf.Positional[Path],
    *,
    minutes: float = 10.0,
    seed: int | None = None,
    workers: int = CORES,
    json: bool = False,
) -> None:
    """Score a submission again: equal to the bit, equal within intervals, or not.

    First files, rows and claims are checked against each other. Then each goal is run
    again; where time is short, as many as fit, in random order. The verdict is kept
    beside the folder, for "marl-mm board". Exit code 1 if it is not equal.

    Args:
        folder: Folder of a submission, which may come from a stranger.
        minutes: Time after which no more goals are begun [min].
        seed: Seed of the order of the goals; default drawn, and printed.
        workers: Processes; the result does not depend on their number.
        json: Print the result as JSON.
    """
    with progress_bars() as bar:
        result = verify(
            folder, minutes=minutes, seed=seed, workers=workers, progress=bar
        )
    notes = [f"  {note}" for note in result.notes]
    text = "\n".join([f"{folder}: {result.in_words()}, seed {result.seed}", *notes])
    show(asdict(result), printable(text), json)
    if result.differences:
        raise SubmissionError(f"{folder} is not equal: {'; '.join(result.differences)}")
