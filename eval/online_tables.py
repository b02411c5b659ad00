"""What online runs show, as Markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from marl_mm.eval.metrics import Row
from marl_mm.eval.online import LEVELS, SB3, OnlineSetting, success_at
from marl_mm.eval.tables import (
    markdown_table,
    percent_with_interval,
    rate_with_interval,
    without,
)

IQM = "IQM at the end [%]"

ONLINE_HEADER = (
    "setting",
    "task",
    "seeds",
    "success at the end [%]",
    IQM,
    "at the best checkpoint [%]",
    "paper [%]",
    "return",
    *(f"episodes to {100 * level:.0f} %" for level in LEVELS),
    "episodes",
)


def online_table(
    summary: Sequence[Row],
    settings: Sequence[OnlineSetting],
    leave_out: Sequence[str] = (),
) -> str:
    """One row per setting, as Markdown, without some columns; see ``online_lines``."""
    return markdown_table(*without(*online_lines(summary, settings), leave_out))


def online_lines(
    summary: Sequence[Row], settings: Sequence[OnlineSetting]
) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Header and lines of the table."""
    by_name = {setting.name: setting for setting in settings}
    lines: list[Sequence[str]] = []
    for row in summary:
        setting = by_name[row["setting"]]
        lines.append(
            (
                setting.about,
                setting.task,
                str(row["seeds"]),
                rate_with_interval(row, "success_last"),
                percent_with_interval(
                    row["success_last_iqm"], row["success_last_iqm_interval"]
                ),
                rate_with_interval(row, "success_best"),
                "" if setting.reported is None else str(setting.reported),
                f"{row['return_last']:.2f}",
                *(_count(row, f"to_{100 * level:.0f}") for level in LEVELS),
                str(row["episodes"]),
            )
        )
    return ONLINE_HEADER, lines


def alpha_worth_table(summary: Sequence[Row], settings: Sequence[OnlineSetting]) -> str:
    """The learnt alpha against the best one held, an agent a row, as Markdown."""
    header = (
        "agent",
        "task",
        "seed",
        "goals",
        "return, alpha learnt",
        "best alpha held",
        "its return",
        "difference [95 % interval]",
        "better on",
    )
    lines = []
    about = {setting.name: setting.about for setting in settings}
    for cell in dict.fromkeys((row["setting"], row["seed"]) for row in summary):
        own = [row for row in summary if (row["setting"], row["seed"]) == cell]
        best = max(own, key=lambda row: float(row["return"]))
        low, high = best["difference_interval"]
        lines.append(
            (
                about[best["setting"]],
                best["task"],
                str(best["seed"]),
                str(best["goals"]),
                f"{best['learnt_return']:.2f}",
                f"{best['alpha']:g}",
                f"{best['return']:.2f}",
                f"{best['difference']:.2f} [{low:.2f}, {high:.2f}]",
                f"{best['better_on']}/{best['goals']}",
            )
        )
    return markdown_table(header, lines)


_AT_EQUAL_STEPS = ("ddpg-her", "ddpg-her-no-layer-norm", "maddpg-her", SB3)
"""Compared at equal steps of the environment; without layer norm ours has the layers of
Stable-Baselines3."""

STEPS = (1_500, 2_000, 3_000, 4_000, 6_000, 8_000)


def steps_table(curves: Sequence[Row], settings: Sequence[OnlineSetting]) -> str:
    """Success by steps of the environment, beside Stable-Baselines3, as Markdown."""
    known = {row["setting"] for row in curves}
    lines = []
    for setting in settings:
        if setting.name not in _AT_EQUAL_STEPS or setting.name not in known:
            continue
        line = [setting.about]
        for steps in STEPS:
            rates = success_at(curves, setting, steps)
            listed = ", ".join(f"{100 * rate:.0f}" for rate in rates)
            mean = f"{100 * sum(rates) / len(rates):.0f} ({listed})"
            line.append("-" if any(map(math.isnan, rates)) else mean)
        lines.append(line)
    header = ("goals reached [%] after", *(f"{steps:,} steps" for steps in STEPS))
    return markdown_table(header, lines)


def updates_table(result: Mapping[str, Any], settings: Sequence[OnlineSetting]) -> str:
    """Gradient updates per second from ``marl-mm bench train``, as Markdown."""
    about = {setting.name: setting.about for setting in settings}
    lines = [
        (about[name], f"{rate:.0f}", f"{result.get(f'{name}_over_sb3', 1.0):.2f}")
        for name, rate in result["updates_per_second"].items()
    ]
    header = ("one thread", "updates per second", "over Stable-Baselines3")
    return markdown_table(header, lines)


def online_text(
    summary: Sequence[Row], settings: Sequence[OnlineSetting], curves: Sequence[Row]
) -> str:
    """The tables with what their columns mean."""
    return f"""Made by `marl-mm ablate online`. Success: mean and deviation over
seeds of the share of goals reached, the same for all, and the wider of two 95 %
intervals: Student's over seeds, Wilson's over goals. IQM: interquartile mean over seeds
and directions, with its 95 % stratified bootstrap interval, which is too narrow for so
few seeds.
Paper: of its learning curves, on a task of its own. Episodes: until an evaluation on
other goals first had the rate, mean over seeds, its 95 % interval and every seed's
count (-: not within the run). The interval is Student's, from the evaluation before to
the one that had the rate, as it was reached in between. The last column is where the
longest run ended: 500 episodes after its best success rate, or with as many as it was
to have.

{online_table(summary, settings)}
{hindsight_in_words(summary)}
At equal steps of the environment: success [%] between the evaluations of the learning
curve, mean over seeds and every seed; - beyond the end of runs that were cut short.

{steps_table(curves, settings)}"""


def hindsight_in_words(summary: Sequence[Row]) -> str:
    """How many of plain DDPG's episodes to 70 % it takes with hindsight, in words."""
    rows = {row["setting"]: row for row in summary}
    if not {"ddpg", "ddpg-her"} <= rows.keys():
        return ""
    ours, plain = (rows[name] for name in ("ddpg-her", "ddpg"))
    for row, words in ((ours, "With hindsight"), (plain, "Without hindsight")):
        if math.isnan(row["to_70"]):
            return f"{words} not every seed comes to 70 %: {row['to_70_seeds']}.\n"
    disjoint = ours["to_70_interval"][1] < plain["to_70_interval"][0]
    return (
        f"With hindsight DDPG comes to 70 % in {ours['to_70'] / plain['to_70']:.2f} of "
        f"the episodes; the intervals {'are disjoint' if disjoint else 'overlap'}.\n"
    )


def _count(row: Row, name: str) -> str:
    seeds = str(row[f"{name}_seeds"]).replace(" ", ", ")
    if math.isnan(row[name]):
        return f"({seeds})"
    low, high = row[f"{name}_interval"]
    interval = "" if math.isnan(low) else f" [{low:.0f}, {high:.0f}]"
    return f"{row[name]:.0f}{interval} ({seeds})"
