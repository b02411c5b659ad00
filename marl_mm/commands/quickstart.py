"""marl-mm quickstart: the whole chain once, small in size and real in every part."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

from marl_mm.commands.options import print_evaluations
from marl_mm.commands.parser import parse_options
from marl_mm.progress import progress_bars
from marl_mm.runs import quickstart
from marl_mm.workers import available_cores


@dataclass(frozen=True)
class Quickstart(quickstart.Quickstart):
    """Collect with PD, train MABC, evaluate both and random: a table and a report."""

    workers: int = field(default_factory=available_cores)
    """Processes; the results do not depend on their number."""

    json: bool = False
    """Print wall times, the dataset's card and the evaluations as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm quickstart``."""
    options = parse_options(Quickstart, "marl-mm quickstart", arguments)
    with progress_bars() as bar:
        values, evaluations = quickstart.run_quickstart(options, bar)
    if options.json:
        print(json.dumps(values, indent=2))
        return
    print_evaluations(evaluations)
    seconds = sum(values["stages_s"].values())
    print(f"{seconds:.0f} s; read {options.out / 'report.md'}")
