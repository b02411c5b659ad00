"""Tables of pages that are made of studies' rows, beside those of the studies."""

import math
from collections.abc import Mapping, Sequence
from math import ceil
from operator import itemgetter
from typing import Any

import numpy as np

from marl_mm.algorithms.fine_tune import online_summary
from marl_mm.eval.bench import SB3
from marl_mm.eval.grouping import grouped
from marl_mm.eval.intervals import (
    difference_interval,
    mean_interval,
    seed_rates,
    success_interval,
)
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.engines_summary import MEASURES
from marl_mm.eval.studies.fine_tuning import FINE_TUNING
from marl_mm.eval.studies.online import CELLS
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.separation import SEPARATION
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.eval.studies.summary import returns_of
from marl_mm.eval.studies.table import RETURN
from marl_mm.eval.suite import ROBUSTNESS
from marl_mm.eval.tables import (
    markdown_table,
    rate_in_interval,
    rate_with_interval,
)

_AT_EQUAL_STEPS = ("ddpg-her", "maddpg-her", SB3, "ddpg-her-no-layer-norm")
"""Settings compared at equal steps of the environment; without layer norm ours has the
layers of Stable-Baselines3."""

STEPS = (1_500, 2_000, 3_000, 4_000, 6_000, 8_000)
"""Steps of the environment at which they are compared."""


def gains(study: Study, store: RowStore, baseline: str) -> dict[tuple[str, str], Row]:
    """By how much cells are better than a setting on the same source.

    Args:
        study: Study of the cells, which are compared at its first probe.
        store: Rows of the cells.
        baseline: Name of that setting.

    Returns:
        By names of source and setting ``success`` and ``return``, means over seeds
        less the baseline's, each with its ``_interval``, Welch's.
    """
    means: dict[tuple[str, str], dict[str, Sequence[float]]] = {}
    for cell in study.cells:
        rows = store.evaluations(cell, range(study.seeds), study.probes[:1])
        of_returns = returns_of(rows).mean(axis=1).tolist()
        means[cell_name(cell)] = {"success": seed_rates(rows), "return": of_returns}
    result = {}
    for (source, setting), values in means.items():
        if setting != baseline:
            row: Row = {}
            for key, others in means[source, baseline].items():
                row[key] = float(np.mean(values[key]) - np.mean(others))
                row[f"{key}_interval"] = difference_interval(values[key], others)
            result[source, setting] = row
    return result


def differences_table(study: Study, store: RowStore, baseline: str) -> str:
    """What ``gains`` finds, a line per cell, as Markdown."""
    about = {setting.name: setting.about for _, setting in study.cells}

    def text(row: Row, key: str, scale: float, digits: int) -> str:
        values = (scale * value for value in (row[key], *row[f"{key}_interval"]))
        mean, low, high = (f"{value:+.{digits}f}" for value in values)
        return f"{mean} [{low}, {high}]"

    lines = [
        [source, about[name], text(row, "success", 100, 1), text(row, "return", 1, 2)]
        for (source, name), row in gains(study, store, baseline).items()
    ]
    header = ["dataset", "setting", "goals reached [points, 95 %]", RETURN]
    return markdown_table(header, lines)


def separation_table(summary: Sequence[Row]) -> str:
    """What algorithms reach from each dataset, and how far apart they are, as Markdown."""
    about = {setting.name: setting.about for _, setting in SEPARATION.cells}
    lines = []
    for name, rows in grouped(summary, "dataset").items():
        by_setting = {row["setting"]: row for row in rows}
        worst, *_, best = sorted(rows, key=itemgetter("success"))
        points = 100 * (best["success"] - worst["success"])
        touch = worst["success_interval"][1] >= best["success_interval"][0]
        lines.append(
            [
                f"`{_short(name)}`",
                *(_rate(by_setting[key]) for key in about),
                f"{points:.1f}",
                "touch" if touch else "apart",
            ]
        )
    ends = ("best less worst [points]", "their intervals")
    return markdown_table(["dataset", *about.values(), *ends], lines)


def baselines_table(summary: Sequence[Row]) -> str:
    """What every algorithm reaches from each dataset, as Markdown."""
    datasets = [*grouped(summary, "dataset")]
    lines = [
        (f"`{setting.removesuffix('-baseline')}`", *map(rate_with_interval, rows))
        for setting, rows in grouped(summary, "setting").items()
    ]
    header = ("algorithm", *(f"`{_short(name)}` [%]" for name in datasets))
    return markdown_table(header, lines)


_OTHERS = {"d3rlpy": "d3rlpy", "qc": "Q-chunking's authors"}
"""Words of the table by the rows' word for whose code it is."""


def known_table(rows: Sequence[Row]) -> str:
    """Returns of ours and somebody else's on the same file, as Markdown."""
    lines: list[list[str]] = []
    for algorithm, some in grouped(rows, "algorithm").items():
        returns = {
            maker: [float(row["return"]) for row in made]
            for maker, made in grouped(some, "from").items()
        }
        spans = {maker: mean_interval(values) for maker, values in returns.items()}
        for other in (maker for maker in returns if maker != "ours"):
            (low, high), (their_low, their_high) = spans["ours"], spans[other]
            cells = (
                f"{np.mean(returns[maker]):.0f} [{spans[maker][0]:.0f}, "
                f"{spans[maker][1]:.0f}]"
                for maker in ("ours", other)
            )
            overlap = "yes" if low <= their_high and their_low <= high else "no"
            more = float(np.mean(returns["ours"]) - np.mean(returns[other]))
            least, most = difference_interval(returns["ours"], returns[other])
            ahead = f"{more:+.0f} [{least:+.0f}, {most:+.0f}]"
            lines.append([f"`{algorithm}`", *cells, _OTHERS[other], overlap, ahead])
    heads = "algorithm", "ours", "theirs", "whose", "overlap", "ours ahead by"
    return markdown_table(heads, lines)


def _rate(row: Row) -> str:
    return rate_in_interval(row["success"], row["success_interval"])


def fine_tuning_table(store: RowStore, summary: Sequence[Row]) -> str:
    """Success before own episodes and after, and what they cost, as Markdown.

    Start, after, dip, regret and steps are by the learning curves' goals, the same at
    all times, means over seeds. RLPD starts from nothing, and has no start or dip.
    """
    lines = []
    ended = {(row["dataset"], row["setting"]): row for row in summary}
    for cell in FINE_TUNING.cells:
        if cell_name(cell) not in ended:
            continue
        row = ended[cell_name(cell)]
        curves = store.curves(cell, range(row["seeds"]))
        online = [
            [
                {"env_steps": point["env_steps"], "success/all": point["success_all"]}
                for point in rows
                if not math.isnan(point["env_steps"])
            ]
            for rows in grouped(curves, "seed").values()
        ]
        fared_each = [online_summary(rows) for rows in online]
        steps = [seed.get("online/steps_to_95", math.inf) for seed in fared_each]
        reached = [f"{some:,.0f}" for some in sorted(steps) if some < math.inf]
        middle = float(np.median(steps))
        start, after = (
            np.array([rows[place]["success/all"] for rows in online])
            for place in (0, -1)
        )
        dip = np.mean([seed["online/dip"] for seed in fared_each])
        setting = cell[1]
        own = setting.fine_tuning.updates_per_step * setting.fine_tuning.online_steps
        starts = setting.config.updates > 0
        lines.append(
            [
                f"`{_short(cell_name(cell)[0])}`",
                setting.about,
                f"{setting.config.updates + own:,}",
                f"{100 * start.mean():.0f}" if starts else "-",
                f"{100 * after.mean():.0f}",
                f"{int((after < start).sum())} of {len(after)}" if starts else "-",
                f"{100 * dip:.0f}" if starts else "-",
                f"{100 * np.mean([seed['online/regret'] for seed in fared_each]):.0f}",
                f"{middle:,.0f}" if middle < math.inf else "-",
                f"{len(reached)} of {len(steps)}",
                _rate(row),
            ]
        )
    header = ["dataset", "way", "updates", "start [%]", "after [%]"]
    header += ["seeds worse after", "dip [points]", "regret [%]"]
    times = ["steps to 95 %, median", "seeds that stayed there"]
    return markdown_table([*header, *times, "at the end [%]"], lines)


def _short(source: str) -> str:
    """A dataset's name without what all have."""
    return source.removeprefix("marl_mm/").removesuffix("-v0").replace("/", "-")


def engine_differences_table(summary: Sequence[Row]) -> str:
    """What the second engine gives more than the first, a line per task, as Markdown.

    Of the paired differences of all policies the median, the least and the largest.
    """
    lines = []
    for task, rows in grouped(summary, "task").items():
        line = [task, str(len(rows))]
        for key, (_, scale, form) in MEASURES.items():
            values = [scale * row[f"{key}_difference"] for row in rows]
            ends = float(np.median(values)), min(values), max(values)
            middle, low, high = (f"{value:+{form}}" for value in ends)
            line.append(f"{middle} [{low}, {high}]")
        lines.append(line)
    heads = [head for head, _, _ in MEASURES.values()]
    return markdown_table(["task", "policies", *heads], lines)


def goals_for(rate: float, half_width: float) -> int:
    """Goals from which on Wilson's 95 % interval reaches no further to either side.

    Args:
        rate: Success rate.
        half_width: How far.
    """

    def reach(goals: int) -> float:
        reached = round(rate * goals)
        low, high = success_interval(reached, goals)
        return max(high - reached / goals, reached / goals - low)

    most = ceil(1 / half_width**2)  # Wilson's is less than 1 / sqrt(goals) by far
    return 1 + max(goals for goals in range(1, most) if reach(goals) > half_width)


def goals_table(half_width: float = 0.05) -> str:
    """How many goals an interval of +- so much needs, by success rate, as Markdown."""
    rates = (0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
    header = [f"at {100 * rate:.0f} %" for rate in rates]
    goals = [str(goals_for(rate, half_width)) for rate in rates]
    return markdown_table(["goals reached", *header], [["goals needed", *goals]])


def success_at(curves: Sequence[Row], episodes: int, env_steps: int) -> list[float]:
    """Every seed's success rate after so many steps, between its evaluations.

    A run that ended when it was flat keeps its last one; one that ended because it was
    to has none, nan.

    Args:
        curves: Points of a setting's learning curves.
        episodes: Episodes that its runs were to have.
        env_steps: Steps of the environment.
    """
    rates = []
    for seed in sorted({row["seed"] for row in curves}):
        rows = [row for row in curves if row["seed"] == seed]
        steps = [0, *(row["env_steps"] for row in rows)]
        successes = [0.0, *(row["success_all"] for row in rows)]
        cut = rows[-1]["episode"] >= episodes and env_steps > steps[-1]
        rates.append(np.nan if cut else float(np.interp(env_steps, steps, successes)))
    return rates


def steps_table(store: RowStore) -> str:
    """Success by steps of the environment, beside Stable-Baselines3, as Markdown."""
    lines = []
    for name, (source, setting) in CELLS.items():
        if name in _AT_EQUAL_STEPS:
            curves = store.curves((source, setting), (0, 1, 2))
            line = [setting.about]
            for steps in STEPS:
                rates = success_at(curves, setting.config.episodes, steps)
                listed = ", ".join(f"{100 * rate:.0f}" for rate in rates)
                mean = f"{100 * sum(rates) / len(rates):.0f} ({listed})"
                line.append("-" if any(map(math.isnan, rates)) else mean)
            lines.append(line)
    header = ("goals reached [%] after", *(f"{steps:,} steps" for steps in STEPS))
    return markdown_table(header, lines)


def updates_table(result: Mapping[str, Any]) -> str:
    """Gradient updates per second from ``marl-mm bench train``, as Markdown."""
    lines = [
        (
            CELLS[name][1].about,
            f"{rate:.0f}",
            f"{result.get(f'{name}_over_sb3', 1.0):.2f}",
        )
        for name, rate in result["updates_per_second"].items()
    ]
    header = ("one thread", "updates per second", "over Stable-Baselines3")
    return markdown_table(header, lines)


def hindsight_in_words(summary: Sequence[Row]) -> str:
    """How many of plain DDPG's episodes to 70 % it takes with hindsight, in words."""
    rows = {row["setting"]: row for row in summary}
    her, plain = (rows[name] for name in ("ddpg-her", "ddpg"))
    for row, words in ((her, "With hindsight"), (plain, "Without hindsight")):
        if math.isnan(row["to_70"]):
            return f"{words} not every seed comes to 70 %: {row['to_70_seeds']}.\n"
    disjoint = her["to_70_interval"][1] < plain["to_70_interval"][0]
    return (
        f"With hindsight DDPG comes to 70 % in {her['to_70'] / plain['to_70']:.2f} of "
        f"the episodes; the intervals {'are disjoint' if disjoint else 'overlap'}.\n"
    )


def disturbances_table() -> str:
    """The suite of disturbances, as Markdown."""
    lines = []
    for name, what in ROBUSTNESS.items():
        strengths = ", ".join(map(str, what.strengths))
        about = f"{what.about}{' (each agent in turn)' * isinstance(what.how, type)}"
        lines.append((f"`{name}`", f"{strengths} {what.unit}".strip(), about))
    return markdown_table(("disturbance", "strengths", "meaning"), lines)
