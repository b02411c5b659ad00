"""Options of ablations of offline learning."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from marl_mm.algorithms.config_checks import Precision
from marl_mm.commands.options import COMMITTED
from marl_mm.eval.ablation import Ablation
from marl_mm.eval.offline_rows import RowStore
from marl_mm.workers import Executor, available_cores

Budget = Literal["full", "smoke"]

RESULTS = "results"
"""Folder of tables, figures and rows among the runs."""


@dataclass(frozen=True)
class AblateOffline:
    """What every ablation of offline learning needs."""

    runs: Path | None = None
    """Folder of the raw runs, RUNS/DATASET/SETTING/SEED; missing ones are trained;
    default runs/offline, or runs/offline-smoke."""

    out: Path | None = None
    """Folder of tables and figures, and in OUT/rows of the evaluations that they are
    made of: what is there need not be trained; default RUNS/results, with --check of
    the full budget in a clone eval/results/offline."""

    seeds: tuple[int, ...] | None = None
    """One run each of every dataset and setting: the seeds, not their number; default
    0 1 2, or what the ablation declares."""

    datasets: tuple[str, ...] | None = None
    """Those named; default all of the ablation. What is missing of ours is collected
    first, which is told with the command that does it."""

    settings: tuple[str, ...] | None = None
    """Those named; default all of the ablation. Of some datasets or settings, files
    are called NAME-part."""

    budget: Budget = "full"
    """"smoke": hardly any training, on the dataset that ships or a few steps of another
    task, to see that everything works."""

    plan: bool = False
    """Only print which runs are missing, and about how long they will take. Datasets
    that are missing, too, are told; to collect them is not counted."""

    check: bool = False
    """Only say whether tables in OUT are what its rows give, to the byte."""

    precision: Precision = "auto"
    """Of matrix products; see "marl-mm train td3-bc --help"."""

    workers: int = field(default_factory=available_cores)
    """Runs at once; the result does not depend on it."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster that shares the folders."""

    resume: bool = False
    """Go on after an interruption, and replace what was drawn until then; runs go on
    from their last checkpoints anyway."""

    overwrite: bool = False
    """Replace tables and figures that exist; runs are never replaced."""

    json: bool = False
    """Print the tables as JSON."""

    def runs_folder(self) -> Path:
        """``runs`` or its default."""
        name = "offline-smoke" if self.budget == "smoke" else "offline"
        return self.runs or Path("runs") / name

    def results(self) -> Path:
        """``out`` or its default."""
        elsewhere = self.out or self.runs or self.budget == "smoke"
        if self.check and not elsewhere and COMMITTED.exists():
            return COMMITTED / "offline"
        return self.out or self.runs_folder() / RESULTS

    def seeds_of(self, ablation: Ablation) -> tuple[int, ...]:
        """``seeds``, or the ablation's."""
        return tuple(range(ablation.seeds)) if self.seeds is None else self.seeds

    def store(self) -> RowStore:
        """What tables and figures are made of."""
        return RowStore(self.results() / "rows")
