"""Settings of how studies are run: folders, budget, processes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from marl_mm.algorithms.config_checks import Precision
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.study import Cell, Study, cell_name
from marl_mm.runs.settings import check_device, check_positive, check_seeds
from marl_mm.runs.training import Device
from marl_mm.sim.config import RECORDED_ENGINE, Engine, default_engine, engine_overrides
from marl_mm.workers import Executor

RESULTS = "results"
"""Folder of tables, figures and rows among the runs."""


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Settings of how studies are run."""

    runs: Path | None = None
    """Folder of the raw runs, RUNS/SOURCE/SETTING/SEED; missing ones are trained;
    default runs/studies, with "-smoke" and "-mujoco" for that budget and engine."""

    out: Path | None = None
    """Folder of tables and figures, and in OUT/rows of the evaluations that they are
    made of: what is there need not be trained; default RUNS/results."""

    seeds: tuple[int, ...] | None = None
    """Seeds of the runs of every source and setting, not their number; default 0 1 2,
    or what the study declares."""

    budget: Literal["full", "night", "smoke"] = "full"
    """"night": at most two seeds of everything, which "full" goes on from; "smoke":
    hardly any training, and datasets of a few steps, to see that everything works."""

    precision: Precision = "auto"
    """Precision of matrix products; see "marl-mm train td3-bc --help"."""

    device: Device = "cpu"
    """Device of offline training; on cuda, a GPU, all seeds of a setting learn side by
    side, so many settings at once as there are workers, and rows are not the bytes of
    cpu."""

    engine: Engine | None = None
    """Engine of the simulation, bullet or mujoco, where a study names none: of the
    datasets that are collected, and of all evaluations; default that of the rows in
    OUT, or bullet, or mujoco where PyBullet is not installed."""

    workers: int = 1
    """Runs at once; the result does not depend on their number."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster that shares the folders."""

    resume: bool = False
    """Go on after an interruption, and replace what was drawn until then; runs go on
    from their last checkpoints anyway."""

    overwrite: bool = False
    """Replace tables and figures that exist; runs are never replaced."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        check_positive(workers=self.workers)
        check_device(self.device)
        if self.device == "cuda" and self.executor == "ray":
            raise UsageError(
                "`device` is cuda with `executor` ray, which gives its processes no "
                "GPU: expected `executor` local"
            )
        make_task(overrides=engine_overrides(self.engine))
        if self.seeds is not None:
            check_seeds(self.seeds)

    @property
    def small(self) -> bool:
        """Whether hardly anything is trained."""
        return self.budget == "smoke"

    @property
    def runs_folder(self) -> Path:
        """``runs`` or its default; the engines' runs are not in one folder."""
        name = "studies-smoke" if self.small else "studies"
        engine = self.engine or default_engine()
        return self.runs or Path("runs") / (
            name if engine == RECORDED_ENGINE else f"{name}-{engine}"
        )

    @property
    def results(self) -> Path:
        """``out`` or its default."""
        return self.out or self.runs_folder / RESULTS

    def run_folder(self, cell: Cell, seed: int) -> Path:
        """Folder of a cell's run."""
        source, setting = cell_name(cell)
        folder = self.runs_folder / source.replace("/", "-") / setting / str(seed)
        return folder.absolute() if self.executor == "ray" else folder  # is elsewhere

    @property
    def store(self) -> RowStore:
        """Rows that tables and figures are made of."""
        return RowStore(self.results / "rows")

    def seeds_of(self, study: Study) -> tuple[int, ...]:
        """``seeds``, or the study's."""
        if self.seeds is not None:
            return self.seeds
        count = min(study.seeds, 2) if self.budget == "night" else study.seeds
        return tuple(range(count))


def refuse_device(device: Device, why: str) -> None:
    """Raise a UsageError for a device that a study has no use for."""
    if device != "cpu":
        raise UsageError(f"`device` is {device}, expected cpu: {why}")


def refuse_precision(precision: Precision, why: str) -> None:
    """Raise a UsageError for a precision that a study has no use for."""
    if precision != "auto":
        raise UsageError(f"`precision` is {precision}, expected auto: {why}")


@dataclass(frozen=True, kw_only=True)
class PolicyOptions(StudyOptions):
    """Settings of studies that train nothing: they run policies in tasks."""

    tasks: tuple[str, ...] = ()
    """Registered names of the tasks."""

    goals: int = 200
    """Number of goals of each policy and task, the same for all policies."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        refuse_device(self.device, "nothing is trained")
        refuse_precision(self.precision, "nothing is trained")
        super().check_settings()
        check_positive(goals=self.goals)
        if not self.tasks:
            raise UsageError(f"`tasks` is empty, expected some of {TASKS.names()}")
        for task in self.tasks:
            TASKS.get(task)
