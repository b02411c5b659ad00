"""marl-mm sweep-alpha: what alpha does, in tables and figures."""

from typing import Annotated

import tyro

from marl_mm.commands.ablate import print_states
from marl_mm.commands.options import CORES
from marl_mm.commands.parser import command
from marl_mm.eval.rows import to_json
from marl_mm.eval.studies.sweep import Sweep, draw_sweep, run_sweep
from marl_mm.eval.tables import rows_table
from marl_mm.progress import progress_bars


@command
def main(
    sweep: Annotated[Sweep, tyro.conf.arg(name="")],
    *,
    workers: int = CORES,
    resume: bool = False,
    overwrite: bool = False,
    check: bool = False,
    json: bool = False,
) -> None:
    """Run the PD agent at fixed alphas, with rules that choose alpha, and with loads.

    Writes figures (response.png, pareto.png, loads.png), means (alpha.csv, worth.csv,
    loads.csv) and every episode (episodes.csv.xz, load_episodes.csv.xz). Takes about
    twenty minutes on two cores, and some more for the loads.

    Args:
        sweep: Size of the sweep.
        workers: Processes; the result does not depend on their number.
        resume: Keep what an interrupted sweep has finished.
        overwrite: Replace OUT if it exists.
        check: Only say whether tables in OUT are what its rows give, to the byte.
        json: Print the means as JSON.
    """
    if check:
        sweep.check_settings()
        print_states([(sweep.out, lambda folder: draw_sweep(sweep.out, folder))], json)
        return
    with progress_bars() as bar:
        tables = run_sweep(sweep, workers, resume, overwrite, bar)
    if json:
        print(to_json(tables))
    else:
        print(f"{rows_table(tables['loads'])}\n{sweep.out}: {', '.join(tables)}")
