"""Evaluations side by side, as Markdown or on the terminal."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from markdown_it import MarkdownIt
from rich.box import SIMPLE_HEAD
from rich.table import Table

from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.metrics import METRICS, Metric
from marl_mm.markdown import literal, one_line
from marl_mm.received import printable_name

_HEADER = ("policy", "goals", "success % [95 % interval]", "steps", "return")

_DIRECTIONS = ("all", "forward", "backward")


def header() -> tuple[str, ...]:
    """Headings of the columns: of every evaluation, and of metrics that have one."""
    return *_HEADER, *(metric.column for metric in _columns().values())


def _columns() -> dict[str, Metric]:
    return {name: metric for name, metric in METRICS.items() if metric.column}


def table_rows(evaluations: Sequence[Evaluation]) -> list[tuple[str, ...]]:
    """One row per policy and direction, formatted."""
    rows: list[tuple[str, ...]] = []
    for evaluation in evaluations:
        goals = evaluation.summary["all"]["episodes"]
        for direction in _DIRECTIONS:
            summary = evaluation.summary.get(direction)
            if summary is None or (summary["episodes"] == goals and direction != "all"):
                continue  # or all lie that way
            low, high = (100 * bound for bound in summary["interval"])
            steps = summary["steps_to_success"]
            rows.append(
                (
                    evaluation.policy,
                    f"{summary['episodes']} {direction}",
                    f"{100 * summary['success_rate']:.1f} [{low:.1f}, {high:.1f}]",
                    "-" if steps is None else f"{steps:.1f}",
                    f"{summary['return']:.2f}",
                    *(
                        _number(summary.get(name), metric.form)
                        for name, metric in _columns().items()
                    ),
                )
            )
    return rows


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table.

    Cells may have Markdown in them. A line break is a space, and "|" begins no cell.
    """
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines) + "\n"


def _cell(text: str) -> str:
    return re.sub(r"(?<!\\)\|", r"\|", one_line(text))


def markdown_html(text: str) -> str:
    """Markdown with tables as HTML; HTML, pictures and links are shown as text."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    page: str = parser.disable(["image", "link", "autolink"]).render(text)
    return page


def rows_table(
    rows: Sequence[Mapping[str, Any]], shown: Callable[[str], str] = str
) -> str:
    """Rows as they are, as Markdown: a column a key.

    Args:
        rows: The rows.
        shown: Function that makes a cell of a text; ``literal`` for strangers' texts.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [[shown(_text(row.get(name, ""))) for name in names] for row in rows]
    return markdown_table([shown(name) for name in names], lines)


def literal_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """``rows_table`` of a stranger's rows: no text in them is read as Markdown."""
    return rows_table(rows, literal)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def percent_with_interval(value: float, interval: tuple[float, float]) -> str:
    """A share [%], with its interval if it is known."""
    low, high = (100 * bound for bound in interval)
    bounds = "" if math.isnan(low) else f" [{low:.1f}, {high:.1f}]"
    return f"{100 * value:.1f}{bounds}"


def points_with_interval(value: float, interval: tuple[float, float]) -> str:
    """A difference of two shares [points], with its interval."""
    mean, low, high = (f"{100 * each:+.1f}" for each in (value, *interval))
    return f"{mean} [{low}, {high}]"


def rate_with_deviation(row: Mapping[str, Any], name: str = "success") -> str:
    """A success rate [%] of ``summarize_success``; of several seeds with deviation."""
    deviation = f" +- {100 * row[f'{name}_std']:.1f}" if row["seeds"] > 1 else ""
    return f"{100 * row[name]:.1f}{deviation}"


def rate_with_interval(row: Mapping[str, Any], name: str = "success") -> str:
    """A success rate as in ``rate_with_deviation``, with its interval."""
    low, high = (100 * bound for bound in row[f"{name}_interval"])
    return f"{rate_with_deviation(row, name)} [{low:.1f}, {high:.1f}]"


def rate_in_interval(rate: float, interval: tuple[float, float]) -> str:
    """A rate and its interval [%], such as 87.6 [83, 92]."""
    low, high = (100 * end for end in interval)
    return f"{100 * rate:.1f} [{low:.0f}, {high:.0f}]"


def engines_of(evaluations: Sequence[Evaluation]) -> str:
    """Engines of evaluations, with their versions where they are known."""
    engines = dict.fromkeys(evaluation.engine for evaluation in evaluations)
    return f"engine: {', '.join(engines)}"


def evaluation_markdown(evaluations: Sequence[Evaluation]) -> str:
    """Evaluations as a Markdown table."""
    return markdown_table(header(), table_rows(evaluations))


def evaluation_table(evaluations: Sequence[Evaluation], width: int = 80) -> Table:
    """Evaluations as a table for a terminal of so many columns, 80 at least.

    What does not fit is the beginning of a policy's name, never a number.
    """
    heads = [name.split(" [")[0] for name in header()]
    rows = [
        (
            printable_name(name),
            goals.replace("forward", "ahead").replace("backward", "behind"),
            *rest,
        )
        for name, goals, *rest in table_rows(evaluations)
    ]
    rest = (
        max(map(len, column)) + 1 for column in list(zip(heads, *rows, strict=True))[1:]
    )
    room = max(width, 80) - 2 - sum(rest)  # the edges
    caption = f"{_CAPTION}; {engines_of(evaluations)}"
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False, caption=caption)
    for column, head in enumerate(heads):
        table.add_column(head, justify="left" if column < 2 else "right", no_wrap=True)
    for name, goals, *numbers in rows:
        short = name if len(name) <= room else "…" + name[1 - room :]
        table.add_row(short, goals, *numbers, end_section=goals.endswith("behind"))
    return table


_CAPTION = (
    "steps: of successes; d_mm, d_mp [m]: hand and base off their targets, mean over "
    "steps; jerk [m/s^3]: of the base"
)
