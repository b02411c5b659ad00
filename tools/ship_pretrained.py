"""Makes the agent that ships anew, of the best of its runs.

``marl-mm ablate online --settings ddpg-her`` trains the runs; then ``python
tools/ship_pretrained.py runs/studies`` writes ``algorithms/pretrained_agent``.
"""

import sys
from pathlib import Path

from marl_mm.algorithms.pretrained import FOLDER, ship
from marl_mm.eval.studies.online import CELLS
from marl_mm.eval.studies.options import StudyOptions


def main(runs: Path) -> None:
    """Ship the seed whose best policy was best by its learning curve's own goals."""
    options, cell = StudyOptions(runs=runs), CELLS["ddpg-her"]
    curves = options.store.curves(cell, (0, 1, 2))
    best = max(curves, key=lambda row: (row["success_all"], row["return_all"]))
    run = options.run_folder(cell, best["seed"])
    ship(run, FOLDER)
    print(f"{FOLDER}: the best policy of {run}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
