"""A study's table: columns over its rows, as Markdown and as HTML."""

import math
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from marl_mm.eval.grouping import grouped
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.settings import Online, Probe
from marl_mm.eval.studies.shown import Reported
from marl_mm.eval.studies.study import Cell, Study, cell_name
from marl_mm.eval.studies.summary import LEVELS
from marl_mm.eval.tables import (
    markdown_html,
    markdown_table,
    percent_with_interval,
    rate_with_deviation,
    rate_with_interval,
)
from marl_mm.sim.config import RECORDED_ENGINE

RETURN = "return [95 %]"
"""Heading of a mean over seeds and goals, with Student's interval over seeds."""

CRITICS = {
    "q_policy": "critic's value, every seed",
    "q_slope": "critic's slope, every seed",
}
"""Headings of the critics' value of the policy's actions, and of how much more they
value going to the goal than away from it; no return can pass 10."""

OVER_HELD = "return over the best alpha held [95 %]"
"""Heading of the learnt alpha's gain over the best fixed one."""

FAILED = "failed"
"""Heading of the numbers of failed episodes of all seeds, by reason."""

IQM = "IQM at the end [%]"
"""Heading of the interquartile mean, of tables with a row per setting."""


@dataclass(frozen=True)
class Line:
    """A cell in a table."""

    cell: Cell
    """Source and setting."""

    reported: Reported | None
    """Reported result."""

    rows: Mapping[str, Row]
    """Rows of the table by probe; a single one in tables with a row per setting."""

    @property
    def row(self) -> Row:
        """The row of the first probe, or of the setting."""
        return next(iter(self.rows.values()))


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    head: str
    """Heading, with the unit in brackets."""

    text: Callable[[Line], str]
    """Text of a cell's line."""


@dataclass(frozen=True)
class Table:
    """The table of a study."""

    study: Study
    """The study."""

    rows: list[Row]
    """Rows as in the CSV file: one per cell and probe, or one per cell."""

    figure: Path | None = None
    """Picture of the learning curves."""

    def markdown(self, leave_out: Sequence[str] = ()) -> str:
        """A line per cell, without the columns of some headings."""
        by_setting = self.study.table == "episodes"
        every = [*_OF_EPISODES] if by_setting else _of_probes(self.study, self.rows)
        if any("engine" in row for row in self.rows):
            every.insert(2, Column("engine", _engine))
        columns = [column for column in every if column.head not in leave_out]
        lines = [[column.text(line) for column in columns] for line in self._lines()]
        return markdown_table([column.head for column in columns], lines)

    def _lines(self) -> Iterator[Line]:
        by_setting = grouped(self.rows, "setting")
        for cell in self.study.cells:
            source, setting = cell_name(cell)
            group = by_setting[setting]
            if self.study.table == "episodes":
                rows = {"": group[0]}
            else:
                probes = {r["probe"]: r for r in group if r["dataset"] == source}
                rows = {probe.name: probes[probe.name] for probe in self.study.probes}
            yield Line(cell, self.study.reported.get((source, setting)), rows)

    def __repr__(self) -> str:
        return f"<Table {self.study.about!r}: {len(self.study.cells)} cells>"

    def _repr_html_(self) -> str:
        """Title, table and figure, for notebooks."""
        text = markdown_html(f"**{self.study.about}**\n\n{self.markdown()}")
        if self.figure is None:
            return text
        data = b64encode(self.figure.read_bytes()).decode()
        return f'{text}\n<img alt="learning curves" src="data:image/png;base64,{data}">'


def _engine(line: Line) -> str:
    """Engines of the probes; older rows name none and are of PyBullet."""
    engines = (str(row.get("engine") or RECORDED_ENGINE) for row in line.rows.values())
    return ", ".join(dict.fromkeys(engines))


# --- A row per probe ---------------------------------------------------------


def _of_probes(study: Study, rows: Sequence[Row]) -> list[Column]:
    """Columns: the first probe in full, the others in short."""
    first, *others = study.probes
    columns = [
        Column("dataset", lambda line: str(line.row["dataset"])),
        Column("setting", lambda line: line.cell[1].about),
        Column(
            f"goals reached [%], {first.about}",
            lambda line: rate_with_interval(line.row),
        ),
        Column("every seed", _every_seed),
        Column("IQM [%]", lambda line: _iqm(line, "success")),
        *map(_short, others),
        Column("paper [%]", _reported),
        Column("difference [points]", _difference),
        Column(RETURN, _return),
        Column("d_mm [m]", lambda line: f"{line.row['d_mm']:.3f}"),
        Column("d_mp [m]", lambda line: f"{line.row['d_mp']:.3f}"),
        Column("alpha", lambda line: f"{line.row['alpha']:.2f}"),
        *map(_critic, CRITICS),
    ]
    if any(probe.alpha is not None for probe in others):
        columns.append(Column(OVER_HELD, _over_held))
    if any("failed" in row for row in rows):
        columns.append(Column(FAILED, lambda line: str(line.row.get("failed", ""))))
    return columns


def _every_seed(line: Line) -> str:
    rates = _in_a_row(line.row["success_seeds"])
    ends = line.row["diverged"]
    return f"{rates}; diverged: {ends}" if ends else rates


def _in_a_row(values: str | float) -> str:
    """Numbers separated by commas; a single one may have been read as a number."""
    return str(values).replace(" ", ", ")


def _critic(key: str) -> Column:
    return Column(CRITICS[key], lambda line: _in_a_row(line.row[f"{key}_seeds"]))


def _iqm(line: Line, name: str) -> str:
    row = line.row
    return percent_with_interval(row[f"{name}_iqm"], row[f"{name}_iqm_interval"])


def _short(probe: Probe) -> Column:
    if probe.alpha is None and probe.engine is None:
        return Column(
            probe.about, lambda line: rate_with_interval(line.rows[probe.name])
        )

    def text(line: Line) -> str:
        row = line.rows[probe.name]
        return f"{rate_with_deviation(row)}, {row['return']:.2f}"

    return Column(f"{probe.about}: goals [%], return", text)


def _reported(line: Line) -> str:
    return "" if line.reported is None else str(line.reported)


def _difference(line: Line) -> str:
    """Our success rate less the reported one, after as many updates."""
    reported = line.reported
    if reported is None or reported.success is None:
        return ""
    config = line.cell[1].config
    if reported.updates not in (None, getattr(config, "updates", None)):
        return ""
    return f"{100 * line.row['success'] - reported.success:+.1f}"


def _return(line: Line) -> str:
    low, high = line.row["return_interval"]
    interval = "" if math.isnan(low) else f" [{low:.2f}, {high:.2f}]"
    return f"{line.row['return']:.2f}{interval}"


def _over_held(line: Line) -> str:
    low, high = line.row["over_held_interval"]
    gain = f"{line.row['over_held']:+.2f} [{low:+.2f}, {high:+.2f}]"
    return f"{gain} over {line.row['best_held']:g}"


# --- A row per setting -------------------------------------------------------


def _episodes(level: float) -> Column:
    name = f"to_{100 * level:.0f}"

    def text(line: Line) -> str:
        row, seeds = line.row, _in_a_row(line.row[f"{name}_seeds"])
        if math.isnan(row[name]):
            return f"({seeds})"
        low, high = row[f"{name}_interval"]
        interval = "" if math.isnan(low) else f" [{low:.0f}, {high:.0f}]"
        return f"{row[name]:.0f}{interval} ({seeds})"

    return Column(f"episodes to {100 * level:.0f} %", text)


def _task(line: Line) -> str:
    source, _ = line.cell
    return source.task if isinstance(source, Online) else ""


_OF_EPISODES = [
    Column("setting", lambda line: line.cell[1].about),
    Column("task", _task),
    Column("seeds", lambda line: str(line.row["seeds"])),
    Column(
        "success at the end [%]",
        lambda line: rate_with_interval(line.row, "success_last"),
    ),
    Column(IQM, lambda line: _iqm(line, "success_last")),
    Column(
        "at the best checkpoint [%]",
        lambda line: rate_with_interval(line.row, "success_best"),
    ),
    Column("paper [%]", _reported),
    Column("return", lambda line: f"{line.row['return_last']:.2f}"),
    *map(_episodes, LEVELS),
    Column("episodes", lambda line: str(line.row["episodes"])),
]
