"""marl-mm quickstart: the whole chain once, small in size and real in every part."""

from typing import Annotated, Any

import tyro

from marl_mm.commands.output import print_evaluations, show
from marl_mm.commands.parser import command
from marl_mm.progress import progress_bars
from marl_mm.runs.quickstart import NO_FILM, Quickstart, run_quickstart
from marl_mm.sim.config import is_installed
from marl_mm.workers import available_cores


def _with_all_cores() -> Quickstart:
    return Quickstart(workers=available_cores())


@command
def main(
    options: Annotated[Any, tyro.conf.arg(name="")] = _with_all_cores,
    *,
    json: bool = False,
) -> None:
    """Collect with PD, train MABC, evaluate both and random: a table and a report.

    Args:
        options: Size and place.
        json: Print wall times, the dataset's card and the evaluations as JSON.
    """
    with progress_bars() as bar:
        values, evaluations = run_quickstart(options, bar)
    if json:
        show(values)
        return
    print_evaluations(evaluations)
    if not is_installed("bullet"):
        print(NO_FILM)
    seconds = sum(values["stages_s"].values())
    print(f"{seconds:.0f} s; read {options.out / 'report.md'}")
