"""Tables and figures of ablations of offline learning, from rows."""

from collections.abc import Sequence
from pathlib import Path

from marl_mm.eval.ablation import Ablation, Cell
from marl_mm.eval.metrics import Row
from marl_mm.eval.offline import ablation_lines, summarize_ablation
from marl_mm.eval.offline_figures import curves_figure
from marl_mm.eval.offline_rows import RowStore
from marl_mm.eval.rows import write_csv
from marl_mm.eval.tables import markdown_table


def drawings(name: str, ablation: Ablation) -> list[str]:
    """Files that an ablation is drawn to."""
    return [f"{name}.csv", *[f"{name}.png"] * ablation.figure]


def draw(
    name: str,
    ablation: Ablation,
    store: RowStore,
    seeds: Sequence[int],
    results: Path,
) -> tuple[list[Row], str]:
    """Write an ablation's table, and its figure if it has one.

    Returns:
        The table's rows, and its text.
    """

    def curves(cell: Cell) -> list[Row]:
        return store.curves(cell, seeds)

    summary = summarize_ablation(ablation, store, seeds)
    lines = ablation_lines(ablation, summary)
    text = markdown_table(*lines)
    write_csv(results / f"{name}.csv", summary)
    if ablation.figure:
        curves_figure(ablation, curves, results / f"{name}.png")
    return summary, text
