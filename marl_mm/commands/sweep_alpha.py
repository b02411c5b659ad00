"""marl-mm sweep-alpha: what alpha does, in tables and figures."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from marl_mm.commands.ablate import check_tables
from marl_mm.commands.parser import parse_options
from marl_mm.eval.rows import to_json
from marl_mm.eval.studies.sweep import Sweep, draw_sweep, run_sweep
from marl_mm.eval.tables import rows_table
from marl_mm.progress import progress_bars
from marl_mm.workers import available_cores


@dataclass(frozen=True, kw_only=True)
class SweepAlpha(Sweep):
    """Run the PD agent at fixed alphas, with rules that choose alpha, and with loads.

    Writes figures (response.png, pareto.png, loads.png), means (alpha.csv, worth.csv,
    loads.csv) and every episode (episodes.csv.xz, load_episodes.csv.xz). Takes about
    twenty minutes on two cores, and some more for the loads.
    """

    workers: int = field(default_factory=available_cores)
    """Processes; the result does not depend on their number."""

    resume: bool = False
    """Keep what an interrupted sweep has finished."""

    overwrite: bool = False
    """Replace OUT if it exists."""

    check: bool = False
    """Only say whether tables in OUT are what its rows give, to the byte."""

    json: bool = False
    """Print the means as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm sweep-alpha``."""
    options = parse_options(SweepAlpha, "marl-mm sweep-alpha", arguments)
    if options.check:
        options.check_settings()
        check_tables([(options.out, lambda folder: draw_sweep(options.out, folder))])
        return
    with progress_bars() as bar:
        tables = run_sweep(
            options, options.workers, options.resume, options.overwrite, bar
        )
    if options.json:
        print(to_json(tables))
    else:
        print(f"{rows_table(tables['loads'])}\n{options.out}: {', '.join(tables)}")
