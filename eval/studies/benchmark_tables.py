"""The benchmark's tables as Markdown."""

from collections.abc import Callable, Sequence
from itertools import chain, groupby

from marl_mm.eval.grouping import grouped
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.benchmark import DATASETS, WHOLE, in_order
from marl_mm.eval.tables import markdown_table, rate_in_interval

_MOST_COLUMNS = 6
"""Largest number of datasets beside each other in a table."""

_NONE = "No dataset has rows of all algorithms that there are rows of.\n"
"""Text in place of a table over datasets."""


def benchmark_table(rows: list[Row]) -> str:
    """Success and tie group of every algorithm on each dataset, as Markdown.

    A cell is a mean over seeds with its interval, bold where it cannot be told from the
    best of the dataset; the last number is the tie group, which a single seed lacks.
    A table has datasets of whole tasks, as many as are not more than six.
    """
    parts: list[dict[str, list[Row]]] = [{}]
    of_dataset = grouped(rows, "dataset")
    for _, names in groupby(of_dataset, lambda name: name.rpartition("/")[0]):
        of_task = {name: of_dataset[name] for name in names}
        if parts[-1] and len(parts[-1]) + len(of_task) > _MOST_COLUMNS:
            parts.append({})
        parts[-1] |= of_task
    tables = "\n".join(
        algorithms_table([*chain(*part.values())], _text) for part in parts
    )
    engines = " and ".join(sorted({row["engine"] for row in rows}))
    seeds, goals = WHOLE
    whole = f"{seeds} seeds and {goals} goals where a cell does not say otherwise"
    return f"{tables}\nOn {engines}; {whole}.\n"


def algorithms_table(rows: Sequence[Row], text: Callable[[Row], str]) -> str:
    """Algorithms by dataset, as Markdown.

    Args:
        rows: Rows, one of each dataset and algorithm at most.
        text: Function of a row that returns its cell.
    """
    texts = {(row["algorithm"], row["dataset"]): text(row) for row in rows}
    datasets = dict.fromkeys(row["dataset"] for row in rows)
    lines = [
        [f"`{name}`", *(texts.get((name, dataset), "") for dataset in datasets)]
        for name in in_order({row["algorithm"] for row in rows})
    ]
    heads = ["algorithm", *(dataset.removeprefix("marl_mm/") for dataset in datasets)]
    return markdown_table(heads, lines)


def _text(row: Row) -> str:
    rate = rate_in_interval(row["success"], row["success_interval"])
    numbers = row["seeds"], row["goals"]
    parts = [f"**{rate}**" if row["first"] else rate]
    parts += [str(row["group"])] * (row["seeds"] > 1)
    parts += ["{} x {}".format(*numbers)] * (numbers != WHOLE)
    return ", ".join(parts)


def overall_table(rows: list[Row]) -> str:
    """What algorithms reach over all datasets, as Markdown."""
    if not rows:
        return _NONE
    lines = [
        [
            f"`{row['algorithm']}`",
            rate_in_interval(row["iqm"], row["iqm_interval"]),
            rate_in_interval(row["mean"], row["mean_interval"]),
            f"{row['first']} of {row['datasets']}",
            str(row["first_alone"]),
        ]
        for row in rows
    ]
    heads = ["algorithm", "IQM [%]", "mean [%]", "not told from the best", "best alone"]
    most = max(row["datasets"] for row in rows)
    fewer = any(row["datasets"] < most for row in rows)
    those = "the benchmark" if fewer else "these"
    return (
        f"{markdown_table(heads, lines)}\nOver {most} of {len(DATASETS)} datasets: "
        f"those that all of {those} have learnt from.\n"
    )


def pairs_table(rows: list[Row]) -> str:
    """Probability that a row's algorithm reaches more than a column's, as Markdown.

    Bold where the interval excludes one half.
    """
    if not rows:
        return _NONE
    chances = {}
    for row in rows:
        low, high = row["improvement_interval"]
        for pair, value in (
            ((row["algorithm"], row["other"]), row["improvement"]),
            ((row["other"], row["algorithm"]), 1 - row["improvement"]),
        ):
            apart = low > 0.5 or high < 0.5
            chances[pair] = f"**{value:.2f}**" if apart else f"{value:.2f}"
    names = in_order({*chain(*chances)})
    lines = [
        [f"`{name}`", *(chances.get((name, other), "") for other in names)]
        for name in names
    ]
    return markdown_table(["more often than", *(f"`{name}`" for name in names)], lines)
