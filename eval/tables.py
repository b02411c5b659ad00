"""Evaluations side by side, as Markdown or on the terminal."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from marl_mm.eval.evaluate import Evaluation

HEADER = (
    "policy",
    "goals",
    "success % [95 % interval]",
    "steps",
    "return",
    "d_mm [m]",
    "d_mp [m]",
    "jerk [m/s^3]",
    "alpha",
)

_DIRECTIONS = ("all", "forward", "backward")


def table_rows(evaluations: Sequence[Evaluation]) -> list[tuple[str, ...]]:
    """One row per policy and direction, formatted."""
    rows: list[tuple[str, ...]] = []
    for evaluation in evaluations:
        for direction in _DIRECTIONS:
            summary = evaluation.summary.get(direction)
            if summary is None:
                continue
            low, high = (100 * bound for bound in summary["interval"])
            steps = summary["steps_to_success"]
            rows.append(
                (
                    evaluation.policy,
                    f"{summary['episodes']} {direction}",
                    f"{100 * summary['success_rate']:.1f} [{low:.1f}, {high:.1f}]",
                    "-" if steps is None else f"{steps:.1f}",
                    f"{summary['return']:.2f}",
                    f"{summary['d_mm']:.3f}",
                    f"{summary['d_mp']:.3f}",
                    f"{summary['base_jerk_rms']:.2f}",
                    f"{summary['alpha']:.2f}",
                )
            )
    return rows


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def evaluation_markdown(evaluations: Sequence[Evaluation]) -> str:
    """Evaluations as a Markdown table."""
    return markdown_table(HEADER, table_rows(evaluations))


def evaluation_table(evaluations: Sequence[Evaluation]) -> Table:
    """Evaluations as a table for a terminal of 80 columns."""
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
    for column, name in enumerate(HEADER):
        short = name.split(" [")[0]
        table.add_column(short, justify="left" if column < 2 else "right", no_wrap=True)
    for row in table_rows(evaluations):
        table.add_row(*row, end_section=row[1].endswith(_DIRECTIONS[-1]))
    return table
