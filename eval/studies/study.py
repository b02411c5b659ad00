"""Declaration of studies."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from marl_mm.datasets.named import named_ids
from marl_mm.declared import like
from marl_mm.errors import UsageError
from marl_mm.eval.studies.settings import (
    BEST,
    LAST,
    Online,
    Probe,
    Setting,
    check_name,
    name_of,
)
from marl_mm.eval.studies.shown import COLUMNS, Curves, Reported
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.settings import as_path, check_seeds, with_settings
from marl_mm.runs.sources import Data, Mix, Source

if TYPE_CHECKING:
    from marl_mm.eval.studies.table import Table

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
            value = getattr(self, field_)
            if not isinstance(value, Iterable):
                raise UsageError(f"{value!r:.80} are no {field_}, expected a sequence")
            object.__setattr__(self, field_, tuple(value))
        if not self.probes:
            raise UsageError(f"{self.about!r} has no probes")
        if self.table not in get_args(_Columns):
            choices = " or ".join(get_args(_Columns))
            raise UsageError(f"table is {self.table!r:.40}, expected {choices}")
        if not self.cells:
            raise UsageError(f"{self.about!r} has no cells")
        for cell in self.cells:
            _check_cell(cell)
        for probe in self.probes:
            if not isinstance(probe, Probe):
                raise UsageError(f"{probe!r:.60} is no Probe, such as LAST")
        if not isinstance(self.figure, bool | Curves):
            raise UsageError(f"figure is {self.figure!r:.40}, expected True or Curves")
        if isinstance(self.figure, Curves):
            self._check_drawn(self.figure.value)
        if like(self.seeds, 3, "seeds") < 1:
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

    def _check_drawn(self, value: str) -> None:
        """Raise a UsageError if a cell's learning curves have no such column."""
        for source, _ in self.cells:
            keys = COLUMNS["episode" if isinstance(source, Online) else "step"]
            columns = [key.replace("/", "_") for key in keys]
            if value not in columns:
                raise UsageError(
                    f"the figure's value is {value!r:.40}, expected one of "
                    f"{', '.join(columns)}"
                )

    def part(
        self,
        datasets: Sequence[str] | None = None,
        settings: Sequence[str] | None = None,
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
        from marl_mm.eval.studies.options import StudyOptions
        from marl_mm.eval.studies.runner import StudyRunner

        paths = {"out": out, "runs": options.pop("runs", None)}
        check_name(name)
        given = [(key, path) for key, path in paths.items() if path is not None]
        options |= {key: as_path(path, key) for key, path in given}
        if options.get("seeds") is not None:
            check_seeds(options["seeds"])
            options["seeds"] = tuple(map(int, options["seeds"]))
        chosen = with_settings("study", StudyOptions(), options)
        return dict(StudyRunner(chosen, bar=progress).run({name: self}))[name]


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
