"""The site's drawings: agents, loop, dataset, trade-off and learning curves."""

import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from svg import COLOURS, FAINT, INK, Plot, Point, arrow, box, drawing, line, words

from marl_mm.datasets.dataset import load_dataset
from marl_mm.envs.tasks.reach import LAYOUT
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.baselines import DATASETS as BASELINE_DATASETS
from marl_mm.eval.studies.baselines import LEARNERS
from marl_mm.layout import Agent

RESULTS = Path(__file__).resolve().parents[1] / "eval/results"
HAND, BALANCE = COLOURS[:2]


def _wrapped(names: Sequence[str], most: int = 30) -> list[str]:
    """Names in lines of at most so many letters."""
    lines = [""]
    for name in names:
        longer = f"{lines[-1]}, {name}" if lines[-1] else name
        lines = [*lines[:-1], longer] if len(longer) <= most else [*lines, name]
    return lines


def _robot(x: float, y: float) -> list[str]:
    """The robot from the side, on the ground at y; its hand is 190 px up."""
    joints = [(x + 95, y - 72), (x + 95, y - 130), (x + 150, y - 205)]
    joints += [(x + 205, y - 175), (x + 215, y - 150)]
    return [
        line([(x - 30, y), (x + 370, y)], INK, 1),
        f'<rect x="{x:g}" y="{y - 72:g}" width="150" height="56" rx="8" '
        f'fill="#eceff1" stroke="{INK}"/>',
        *(
            f'<circle cx="{x + at:g}" cy="{y - r:g}" r="{r}" fill="#cfd8dc" '
            f'stroke="{INK}"/>'
            for at, r in ((75, 16), (20, 8), (130, 8))
        ),
        line(joints, "#78909c", 11),
        *(f'<circle cx="{a:g}" cy="{b:g}" r="5" fill="{INK}"/>' for a, b in joints[:4]),
    ]


def agent_lines(agent: Agent, most: int = 30) -> list[str]:
    """What an agent sees and sets, in lines of at most so many letters."""
    sees = ("  " + names for names in _wrapped(agent.sees, most))
    return ["sees", *sees, f"sets  {', '.join(agent.sets)}"]


def agents() -> str:
    """What each agent sees and sets, around the robot."""
    hand, balance = LAYOUT.team
    goal = (615.0, 235.0)
    parts = [
        box(
            *(20, 20, 270, 160),
            f"agent {hand.name}",
            *agent_lines(hand),
            colour=HAND,
        ),
        box(
            *(20, 210, 270, 160),
            f"agent {balance.name}",
            *agent_lines(balance),
            colour=BALANCE,
        ),
        *_robot(380, 345),
        f'<circle cx="{goal[0]:g}" cy="{goal[1]:g}" r="6" fill="none" stroke="{HAND}" '
        'stroke-width="2" stroke-dasharray="3 2"/>',
        words(630, 240, "target of the hand", size=13, colour=HAND),
        f'<circle cx="720" cy="150" r="9" fill="{COLOURS[2]}"/>',
        words(735, 155, "goal", size=13, colour=COLOURS[2]),
        arrow((290, 90), (615, 90), (615, 226)),
        words(310, 82, "10 cm a step at most", size=12, colour=HAND),
        arrow((290, 315), (376, 315)),
        words(300, 306, "alpha", size=13, colour=BALANCE),
        words(
            *(560, 300),
            "alpha 1: base stable, the hand waits",
            "alpha 0: hand accurate, the base lurches",
            size=13,
            colour=BALANCE,
        ),
    ]
    return drawing(900, 390, parts, "The two agents, what each sees and sets")


def _tick() -> float:
    """Median time of a whole tick [us]."""
    measured = json.loads((RESULTS / "controller/bench.json").read_text("utf-8"))
    return float(measured["us"]["tick"]["median"])


def loop() -> str:
    """The policy at 1 Hz over the controller at 240 Hz."""
    parts = [
        box(
            *(20, 40, 190, 110),
            "policy, 1 Hz",
            "joint state in,",
            "displacement of the",
            "hand and alpha out",
        ),
        box(
            *(300, 40, 270, 110),
            "controller, 240 Hz",
            "5 tasks, 4 levels, limits",
            "priorities by alpha",
            f"{_tick():.0f} us a tick with simulation",
        ),
        box(
            660,
            40,
            200,
            110,
            "simulator, 240 Hz",
            "PyBullet: base on its",
            "wheels, arm",
        ),
        arrow((210, 80), (298, 80)),
        words(216, 72, "order", size=12),
        arrow((570, 80), (658, 80)),
        words(574, 72, "torques,", size=12),
        words(574, 97, "wheel speeds", size=12),
        arrow((760, 150), (760, 190), (435, 190), (435, 152)),
        words(500, 184, "joints and base, every 1/240 s", size=12),
        arrow((810, 150), (810, 225), (115, 225), (115, 152)),
        words(300, 219, "state, reward, info: after 240 ticks", size=12),
    ]
    return drawing(880, 245, parts, "The loop: policy at 1 Hz, controller at 240 Hz")


def dataset() -> str:
    """What a dataset is made of."""
    steps = [
        f'<rect x="{40 + 46 * i}" y="60" width="40" height="34" rx="4" '
        f'fill="{COLOURS[0]}" fill-opacity="{0.25 if i < 5 else 0.08}" '
        f'stroke="{COLOURS[0]}"/>'
        for i in range(9)
    ]
    parts = [
        words(40, 40, "episode: seed, start, policy", bold=True),
        *steps,
        words(44, 82, "s0", size=12),
        words(90, 82, "s1", size=12),
        words(136, 82, "...", size=12),
        words(274, 40, "the next one", colour=FAINT),
        words(
            *(40, 120),
            "a step: joint state, joint action, reward, terminated, truncated, info",
            size=13,
        ),
        box(
            *(520, 25, 340, 130),
            "with it on the disk",
            "layout: names, units, bounds, agents",
            "provenance: task, collector, seeds",
            "hashes of every array",
            "card: success, returns, coverage",
        ),
        arrow((120, 135), (120, 185)),
        arrow((300, 135), (300, 185)),
        arrow((690, 155), (690, 185)),
        box(
            20, 188, 190, 80, "data.joint()", "all entries, as one", "learner sees them"
        ),
        box(
            *(225, 188, 240, 80),
            'data.agents()["balance"]',
            "the same steps,",
            "as one agent sees them",
            colour=BALANCE,
        ),
        box(
            *(560, 188, 300, 80),
            "verify --replay",
            "every episode comes out again",
            "of its seed and actions, to the bit",
        ),
    ]
    return drawing(880, 285, parts, "What a dataset is made of")


def tradeoff() -> str:
    """Errors of hand and base over alpha, as the committed sweep has them."""
    rows = [
        row
        for row in read_rows(RESULTS / "alpha/alpha.csv")
        if (row["task"], row["form"], row["rule"]) == ("Reach-v0", "blend", "constant")
        and row["direction"] == "backward"
    ]
    rows.sort(key=lambda row: float(row["alpha"]))
    errors = Plot((80, 30, 330, 210), (0, 1), (0, 80), ("alpha", "error [mm]"))
    jerk = Plot((520, 30, 330, 210), (0, 1), (0, 16), ("alpha", "base jerk [m/s^3]"))
    for name, colour in (("d_mm", HAND), ("d_mp", BALANCE)):
        errors.curve([(row["alpha"], 1000 * row[name]) for row in rows], colour)
    jerk.curve([(row["alpha"], row["base_jerk_rms"]) for row in rows], INK)
    parts = [
        *errors.parts,
        *jerk.parts,
        words(290, 52, "hand", colour=HAND, bold=True),
        words(130, 100, "base", colour=BALANCE, bold=True),
    ]
    return drawing(880, 300, parts, "Goals behind: errors and base jerk over alpha")


def _means(curves: dict[int, list[Point]]) -> list[Point]:
    """Mean over the seeds at every place that all of them have."""
    values = [dict(points) for points in curves.values()]
    places = sorted(set.intersection(*(set(curve) for curve in values)))
    return [(x, sum(curve[x] for curve in values) / len(values)) for x in places]


def _learning(
    kinds: Mapping[str, Sequence[dict[str, Any]]], x: str, label: str, about: str
) -> str:
    """Goals reached over updates or episodes: seeds, their mean, a colour a kind."""
    most = max(row[x] for rows in kinds.values() for row in rows)
    plot = Plot((80, 30, 560, 210), (0, most), (0, 100), (label, "goals reached [%]"))
    names = []
    for number, (name, rows) in enumerate(kinds.items()):
        colour = COLOURS[number]
        curves: dict[int, list[Point]] = defaultdict(list)
        for row in rows:
            curves[row["seed"]].append((row[x], 100 * row["success_all"]))
        for points in curves.values():
            plot.curve(points, colour, faint=True)
        plot.curve(_means(curves), colour)
        at = 560 - 150 * number
        names.append(words(at, 20, name, size=13, colour=colour, bold=True))
    return drawing(680, 300, [*plot.parts, *names], about)


def _offline(algorithm: str, **settings: str) -> str:
    folder = RESULTS / "studies/rows/good-30k"
    kinds = {
        name.replace("_", " "): read_rows(folder / f"{setting}.curve.csv.xz")
        for name, setting in settings.items()
    }
    about = f"{algorithm} on good-30k: goals reached over updates, mean and seeds"
    return _learning(kinds, "step", "updates", about)


def _baseline(algorithm: str) -> str:
    kinds = {}
    for dataset in BASELINE_DATASETS:
        folder = RESULTS / f"studies/rows/marl_mm-{dataset}-v0"
        kinds[dataset] = read_rows(folder / f"{algorithm}-baseline.curve.csv.xz")
    about = f"{algorithm}: goals reached over updates, mean and seeds"
    return _learning(kinds, "step", "updates", about)


def _online(algorithm: str, **settings: str) -> str:
    folder = RESULTS / "studies/rows/online-Reach-v0"
    kinds = {
        name.replace("_", " "): read_rows(folder / f"{setting}.curve.csv.xz")
        for name, setting in settings.items()
    }
    about = f"{algorithm} on Reach-v0: goals reached over episodes, mean and seeds"
    return _learning(kinds, "episode", "episodes", about)


CURVES: dict[str, Callable[[], str]] = {
    "mabc": partial(_offline, "mabc", tuned="mabc-180k"),
    "td3-bc": partial(
        _offline, "td3-bc", tuned="td3-bc-tuned-180k", paper="td3-bc-paper-180k"
    ),
    "matd3-bc": partial(
        _offline, "matd3-bc", tuned="matd3-bc-tuned-180k", paper="matd3-bc-paper-180k"
    ),
    "ddpg": partial(_online, "ddpg", tuned="ddpg", paper="ddpg-paper"),
    "ddpg-her": partial(_online, "ddpg-her", tuned="ddpg-her", paper="ddpg-her-paper"),
    "maddpg-her": partial(_online, "maddpg-her", tuned="maddpg-her"),
}
"""Learning curves by algorithm."""


def _card(name: str) -> str:
    """Returns of a dataset's episodes, and alphas of its steps."""
    card = load_dataset(name).card()
    parts: list[str] = []
    for left, what, *labels in (
        (80, "return_histogram", "return", "episodes"),
        (500, "alpha_histogram", "alpha", "steps"),
    ):
        histogram = card[what]
        counts, low, high = (histogram[key] for key in ("counts", "low", "high"))
        most = max(counts)
        plot = Plot(
            (left, 30, 300, 150), (low, high), (0, most), (labels[0], labels[1])
        )
        width = (high - low) / len(counts)
        for number, count in enumerate(counts):
            x0, y0 = plot.at(low + number * width, count)
            x1, y1 = plot.at(low + (number + 1) * width, 0)
            parts.append(
                f'<rect x="{x0 + 1:.1f}" y="{y0:.1f}" width="{x1 - x0 - 2:.1f}" '
                f'height="{y1 - y0:.1f}" fill="{HAND}" fill-opacity="0.7"/>'
            )
        parts += plot.parts
    return drawing(840, 235, parts, f"Returns and alphas of {name}")


DRAWINGS: dict[str, Callable[[], str]] = {
    "images/agents.svg": agents,
    "images/loop.svg": loop,
    "images/dataset.svg": dataset,
    "images/tradeoff.svg": tradeoff,
    **{f"images/curve-{name}.svg": draw for name, draw in CURVES.items()},
    **{
        f"images/baseline-{setting.algorithm}.svg": partial(
            _baseline, setting.algorithm
        )
        for setting in LEARNERS
    },
    "images/card-good-5k.svg": partial(_card, "good-5k"),
}
"""Path below docs/, and what draws it."""
