"""What online runs show, as Markdown."""

import math
from collections.abc import Sequence

from marl_mm.eval.metrics import Row
from marl_mm.eval.online import LEVELS, Setting, success_at
from marl_mm.eval.tables import markdown_table

ONLINE_HEADER = (
    "setting",
    "task",
    "seeds",
    "success at the end [%]",
    "at the best checkpoint [%]",
    "return",
    *(f"episodes to {100 * level:.0f} %" for level in LEVELS),
    "episodes",
)


def online_table(summary: Sequence[Row], settings: Sequence[Setting]) -> str:
    """One row per setting, as Markdown."""
    by_name = {setting.name: setting for setting in settings}
    lines = []
    for row in summary:
        setting = by_name[row["setting"]]
        lines.append(
            (
                setting.about,
                setting.task,
                str(row["seeds"]),
                _success(row, "last"),
                _success(row, "best"),
                f"{row['return_last']:.2f}",
                *(_count(row, f"to_{100 * level:.0f}") for level in LEVELS),
                str(row["episodes"]),
            )
        )
    return markdown_table(ONLINE_HEADER, lines)


SB3 = ("ddpg-her", "maddpg-her", "sb3-ddpg-her")
"""Compared at equal steps of the environment."""

STEPS = (1_500, 2_000, 3_000, 4_000, 6_000, 8_000)


def steps_table(curves: Sequence[Row], settings: Sequence[Setting]) -> str:
    """Success by steps of the environment, beside Stable-Baselines3, as Markdown."""
    lines = []
    for setting in settings:
        if setting.name not in SB3:
            continue
        line = [setting.about]
        for steps in STEPS:
            rates = success_at(curves, setting.name, steps)
            listed = ", ".join(f"{100 * rate:.0f}" for rate in rates)
            line.append(f"{100 * sum(rates) / len(rates):.0f} ({listed})")
        lines.append(line)
    header = ("goals reached [%] after", *(f"{steps:,} steps" for steps in STEPS))
    return markdown_table(header, lines)


def online_markdown(
    summary: Sequence[Row], settings: Sequence[Setting], curves: Sequence[Row]
) -> str:
    """The tables with what their columns mean."""
    return f"""# Online learning

Made by `marl-mm ablate online`. Success: mean and standard deviation over seeds of the
share of 200 goals, the same for all, and Wilson's 95 % interval over the goals of all
seeds. Episodes: until an evaluation on 50 other goals first showed the rate, mean over
seeds, Student's 95 % interval and every seed's count. The last column is where the
longest run ended: after 2,000 episodes, or 500 after its best success rate.

{online_table(summary, settings)}
At equal steps of the environment: the last evaluation on 50 goals within them, mean
over seeds and every seed.

{steps_table(curves, settings)}"""


def _success(row: Row, checkpoint: str) -> str:
    mean, std = (100 * row[f"success_{checkpoint}{end}"] for end in ("", "_std"))
    low, high = (100 * bound for bound in row[f"success_{checkpoint}_interval"])
    return f"{mean:.1f} +- {std:.1f} [{low:.1f}, {high:.1f}]"


def _count(row: Row, name: str) -> str:
    seeds = str(row[f"{name}_seeds"]).replace(" ", ", ")
    if math.isnan(row[name]):
        return f"({seeds})"
    low, high = row[f"{name}_interval"]
    interval = "" if math.isnan(low) else f" [{low:.0f}, {high:.0f}]"
    return f"{row[name]:.0f}{interval} ({seeds})"
