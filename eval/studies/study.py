"""Declaration of studies: sources, settings that learn from them, and evaluations."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.datasets.named import named_ids
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.studies.shown import Curves, Reported
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.settings import check_seeds, with_settings
from marl_mm.runs.sources import Data, Mix, Source
from marl_mm.sim.config import Engine

if TYPE_CHECKING:
    from marl_mm.eval.studies.table import Table

_NONE: Mapping[str, Any] = MappingProxyType({})


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[A-Za-z][\w.-]*", name):
        raise UsageError(
            f"name is {name!r}, expected a letter and then letters, digits, '-', '_' "
            "or '.'"
        )


# --- Sources -----------------------------------------------------------------


@dataclass(frozen=True)
class Online:
    """A source: episodes of the learner's own."""

    task: str = DEFAULT
    """Registered name of the task."""

    demonstrations: Data | None = None
    """Dataset whose episodes are replayed too."""

    name: str = ""
    """Name of the source in rows; default made of the fields above."""

    def __post_init__(self) -> None:
        """Refuse an unknown task, and make the default name."""
        make_task(self.task)
        if not self.name:
            beside = (
                () if self.demonstrations is None else (name_of(self.demonstrations),)
            )
            object.__setattr__(self, "name", "-".join(("online", self.task, *beside)))


def name_of(source: Data | Online) -> str:
    """Name of a source in rows and tables."""
    return source if isinstance(source, str) else source.name


# --- Settings and probes -----------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """An algorithm with its hyper-parameters and evaluations."""

    name: str
    """Name of the setting's folder; no two settings of a study share one."""

    about: str
    """Description in tables."""

    algorithm: str = "td3-bc"
    """Registered name of the algorithm."""

    preset: str = TUNED
    """Preset of hyper-parameters that the changes are made to."""

    changes: Mapping[str, Any] = field(default_factory=dict)
    """Hyper-parameters that replace the preset's."""

    goals: int = 200
    """Number of goals of each evaluation of a trained policy."""

    curve_every: int = 5_000
    """Updates between points of the learning curve, of offline runs."""

    curve_goals: int | None = None
    """Number of goals of each of these points; default 20 offline and 50 online."""

    task: str | None = None
    """Registered name of the task of the evaluations, of offline runs; default the
    dataset's."""

    max_steps: int | None = None
    """Steps of an episode; default the task's."""

    measured: tuple[str, ...] | None = None
    """Columns of evaluated goals that rows keep beside the success; default all."""

    fine_tuning: FineTuning = field(default_factory=FineTuning)
    """How offline runs go on with own episodes; none by default."""

    library: Literal["marl_mm", "sb3"] = "marl_mm"
    """Implementation: ours, or Stable-Baselines3's DDPG + HER."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be run."""
        _check_name(self.name)
        if self.goals < 2 or self.goals % 2:
            raise UsageError(f"goals is {self.goals}, expected 2, 4, 6 ...: each way")
        _ = self.config

    @property
    def config(self) -> Any:
        """Hyper-parameters."""
        default = preset(self.algorithm, self.preset)
        try:
            return with_settings(self.algorithm, default, self.changes)
        except UsageError as error:
            raise UsageError(f"setting {self.name!r}: {error}") from None

    @property
    def online(self) -> bool:
        """Whether the algorithm learns from episodes of its own."""
        return ALGORITHMS.get(self.algorithm).online


def setting_of(
    name: str,
    algorithm: str,
    updates: int,
    changes: Mapping[str, Any] = _NONE,
    **more: Any,
) -> Setting:
    """Setting of a study of several algorithms: the tuned preset, with its title.

    Args:
        name: Name of the setting's folder.
        algorithm: Registered name of the algorithm.
        updates: Number of updates.
        changes: Other hyper-parameters that replace the preset's.
        **more: Other fields of the setting.
    """
    title = ALGORITHMS.get(algorithm).title
    changes = {**changes, "updates": updates}
    return Setting(name, title, algorithm, changes=changes, **more)


@dataclass(frozen=True)
class Probe:
    """An evaluation of a trained run."""

    name: str
    """Name in rows, and of the evaluation's file in the run."""

    about: str
    """Description in tables."""

    checkpoint: Literal["last", "best"] = "last"
    """Checkpoint that is evaluated."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the task that are replaced."""

    alpha: float | None = None
    """Fixed alpha that replaces the policy's; None: the policy's own."""

    task: str | None = None
    """Registered name of the task; None: the one that the run was trained for."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be evaluated."""
        _check_name(self.name)
        if self.checkpoint not in ("last", "best"):
            raise UsageError(
                f"checkpoint is {self.checkpoint!r}, expected one of last, best"
            )
        if self.alpha is not None and not 0 <= self.alpha <= 1:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        make_task(self.task or DEFAULT, self.overrides)  # raises

    @property
    def engine(self) -> Engine | None:
        """Engine that the overrides name, if they do."""
        engine: Engine | None = self.overrides.get("simulation", {}).get("engine")
        return engine

    @property
    def way(self) -> dict[str, Any]:
        """The evaluation's settings without its name."""
        values = asdict(self)
        elsewhere = () if self.task is None else ("task",)  # older records have none
        names = ("checkpoint", "overrides", "alpha", *elsewhere)
        return {key: values[key] for key in names}

    def file(self, run: Path) -> Path:
        """File of the evaluation in a run folder."""
        if self.name == BEST.name and self != BEST:  # not the training's own
            return run / f"eval_probe_{self.name}.json"
        return run / ("eval.json" if self == LAST else f"eval_{self.name}.json")


LAST = Probe("last", "at the end")
BEST = Probe("best", "at the best checkpoint", checkpoint="best")

# --- Studies -----------------------------------------------------------------


_Columns = Literal["probes", "episodes"]

Cell = tuple[Data | Online, Setting]
"""A line of a table or a curve of a figure: a source and a setting."""


def cell_name(cell: Cell) -> tuple[str, str]:
    """Names of a cell's source and setting."""
    return name_of(cell[0]), cell[1].name


@dataclass(frozen=True)
class Study:
    """A table of cells, and maybe a figure of their learning curves."""

    about: str
    """Title."""

    cells: Sequence[Cell]
    """Pairs of a source and a setting."""

    probes: Sequence[Probe] = (LAST,)
    """Evaluations of each run."""

    figure: bool | Curves = False
    """Whether learning curves are drawn, or their description."""

    reported: Mapping[tuple[str, str], Reported] = field(default_factory=dict)
    """Results of others, by names of source and setting."""

    seeds: int = 3
    """Number of runs of each cell; they are seeded 0, 1, 2 ..."""

    table: _Columns = "probes"
    """Columns: success of every probe, or success at the end and at best, and the
    episodes that it took."""

    def __post_init__(self) -> None:
        """Refuse cells that share a name or cannot be run."""
        for field_ in ("cells", "probes"):  # which may be generators
            object.__setattr__(self, field_, tuple(getattr(self, field_)))
        if not self.probes:
            raise UsageError(f"{self.about!r} has no probes")
        if self.table not in get_args(_Columns):
            choices = " or ".join(get_args(_Columns))
            raise UsageError(f"table is {self.table!r:.40}, expected {choices}")
        if not self.cells:
            raise UsageError(f"{self.about!r} has no cells")
        for cell in self.cells:
            _check_cell(cell)
        if self.seeds < 1:
            raise UsageError(f"{self.about!r} has {self.seeds} seeds, expected >= 1")
        names = [cell_name(cell) for cell in self.cells]
        for name in self.reported:
            if name not in names:
                raise UsageError(f"{name!r} is reported, but no cell has these names")
        by_setting = self.table == "episodes"
        online = all(isinstance(source, Online) for source, _ in self.cells)
        if by_setting and not (online and LAST in self.probes and BEST in self.probes):
            raise UsageError(
                "table is 'episodes', expected cells that learn online, and the probes "
                "LAST and BEST"
            )
        _check_once([s if by_setting else f"{d}, {s}" for d, s in names])
        _check_once([probe.name for probe in self.probes])

    def part(
        self, datasets: Sequence[str] | None, settings: Sequence[str] | None
    ) -> "Study":
        """The study with the cells of some sources and settings only; None: all."""
        datasets = datasets and [named_ids().get(name, name) for name in datasets]
        names = [cell_name(cell) for cell in self.cells]
        sources = _chosen("datasets", datasets, [name for name, _ in names])
        ways = _chosen("settings", settings, [name for _, name in names])
        pairs = zip(self.cells, names, strict=True)
        cells = tuple(c for c, (d, s) in pairs if d in sources and s in ways)
        if not cells:
            raise UsageError(
                f"`settings` {' '.join(ways)} are not run on `datasets` "
                f"{' '.join(sources)}: leave out one of both"
            )
        left = {cell_name(cell) for cell in cells}
        reported = {name: self.reported[name] for name in self.reported if name in left}
        return replace(self, cells=cells, reported=reported)

    def run(
        self,
        out: str | Path | None = None,
        *,
        name: str = "study",
        progress: Bar = silent_bar,
        **options: Any,
    ) -> "Table":
        """Train and evaluate what is missing, and draw the table and the figure.

        Args:
            out: Folder of the table, the figure and their rows; default RUNS/results.
            name: Name of the table's and the figure's files.
            progress: Called in a thread with a label and the amount of work; returns a
                function that is called with the work done and a note.
            **options: Fields of ``StudyOptions``: ``runs``, ``seeds``, ``workers``,
                ``budget``, ``resume``, ``overwrite`` ...

        Raises:
            UsageError: If an option makes no sense, or the table exists.
            OtherConfigError: If rows or runs there were made otherwise.
            FailedRunsError: If runs failed.
            KeyboardInterrupt: After Ctrl-C; ``resume=True`` goes on.
        """
        from marl_mm.eval.studies.engine import Engine
        from marl_mm.eval.studies.options import StudyOptions

        paths = {"out": out, "runs": options.pop("runs", None)}
        options |= {key: Path(path) for key, path in paths.items() if path is not None}
        if options.get("seeds") is not None:
            check_seeds(options["seeds"])
            options["seeds"] = tuple(map(int, options["seeds"]))
        chosen = with_settings("study", StudyOptions(), options)
        return dict(Engine(chosen, bar=progress).run({name: self}))[name]


def _check_cell(cell: Any) -> None:
    match cell:
        case (Source() | Mix() | str() | Online() as source, Setting() as setting):
            if setting.online != isinstance(source, Online):
                ways = ("a dataset", "episodes of its own, Online(...)")
                raise UsageError(
                    f"setting {setting.name!r} cannot learn from {name_of(source)}: "
                    f"{setting.algorithm} learns from {ways[setting.online]}"
                )
        case _:
            raise UsageError(
                f"{cell!r} is no cell, expected pairs of a source (a Source, a Mix, "
                "Online, or a dataset's name) and a Setting"
            )


def _check_once(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"{name!r} stands there twice, expected once")


def _chosen(
    option: str, asked: Sequence[str] | None, names: Sequence[str]
) -> Sequence[str]:
    choices = list(dict.fromkeys(names))
    unknown = [name for name in asked or () if name not in choices]
    if unknown or (asked is not None and not asked):
        missing = f"has no {unknown[0]!r}" if unknown else "is empty"
        raise UsageError(f"`{option}` {missing}: expected {', '.join(choices)}")
    return choices if asked is None else asked
