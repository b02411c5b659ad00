"""From rows to a study's table: by hand."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.eval.intervals import success_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.alpha import ALPHAS, LEARNT, _steps, summarize_worth
from marl_mm.eval.studies.figures import on_a_grid
from marl_mm.eval.studies.held import FixedAlpha
from marl_mm.eval.studies.online import STUDIES
from marl_mm.eval.studies.settings import LAST, Probe, Setting
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.summary import (
    CellRows,
    _by_probe,
    _of_probe,
    episodes_to,
    row_of_setting,
    worth_of_alpha,
)
from marl_mm.eval.studies.table import Table

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools"))
PAGES: Any = importlib.import_module("study_tables")

DDPG = STUDIES["online"].part(None, ["ddpg"])


def curve(seed: int, rates: list[float]) -> list[Row]:
    return [
        {"seed": seed, "episode": 20 * (i + 1), "success_all": rate}
        for i, rate in enumerate(rates)
    ]


def summarized(curves: list[Row], *successes: list[int]) -> Row:
    """The row of DDPG, of which every seed has reached such goals."""
    goals = [
        {
            "seed": seed,
            "goal": goal,
            "direction": "forward",
            "success": success,
            "return": 2.0 * success,
        }
        for seed, own in enumerate(successes)
        for goal, success in enumerate(own)
    ]
    rows = CellRows(DDPG.cells[0], {"last": goals, "best": goals}, curves, "")
    return row_of_setting(rows)


def test_episodes_to_a_level_by_hand() -> None:
    rows = curve(0, [0.1, 0.7, 0.6, 0.96])
    assert episodes_to(rows, 0.70) == (20, 40)
    assert episodes_to(rows, 0.95) == (60, 80)
    assert episodes_to(rows, 0.05) == (0, 20)
    assert episodes_to(rows, 0.99) is None


def test_a_summary_by_hand() -> None:
    curves = curve(0, [0.1, 0.7, 0.96]) + curve(1, [0.8, 0.9, 0.9])
    row = summarized(curves, [1, 1, 1, 1], [1, 0, 1, 0])
    assert row["seeds"] == 2
    assert row["success_last"] == 0.75
    assert row["success_last_std"] == pytest.approx(0.25 * 2**0.5)
    assert row["return_best"] == 1.5
    assert row["to_70"] == 30 and row["to_70_seeds"] == "40 20"
    assert np.isnan(row["to_95"]) and row["to_95_seeds"] == "60 -"
    table = Table(DDPG, [row]).markdown()
    assert "| 30 [0, 157] (40, 20) | (60, -) |" in table  # t(1) = 12.7, s = 14.1


def test_an_interval_reaches_back_to_the_evaluation_before() -> None:
    """Three seeds that showed a rate in the same evaluation do not make it exact."""
    curves = [row for seed in range(3) for row in curve(seed, [0.1, 0.2, 0.8])]
    row = summarized(curves, [1, 0], [1, 0], [1, 0])
    assert row["to_70"] == 60 and row["to_70_interval"] == (40, 60)


def test_success_at_equal_steps_lies_between_evaluations() -> None:
    rows = [
        {**row, "env_steps": 100 * (i + 1)}
        for i, row in enumerate(curve(0, [0.2, 0.4]))
    ]
    assert PAGES.success_at(rows, 1_000, 50) == [pytest.approx(0.1)]
    assert PAGES.success_at(rows, 1_000, 150) == [pytest.approx(0.3)]
    assert PAGES.success_at(rows, 1_000, 900) == [0.4]  # it ended when it was flat
    assert PAGES.success_at(rows, 40, 200) == [0.4]
    assert np.isnan(PAGES.success_at(rows, 40, 201)).all()


def test_curves_of_unequal_length_meet_on_a_grid() -> None:
    times, values = on_a_grid(
        curve(0, [0.0, 1.0]) + curve(1, [0.5, 0.5, 0.7]), "success_all"
    )
    np.testing.assert_array_equal(times, [20, 40, 60])
    np.testing.assert_array_equal(values, [[0, 1, 1], [0.5, 0.5, 0.7]])


def test_a_run_that_diverged_before_its_own_steps_is_left_out() -> None:
    """Files have empty cells where another seed's rows have a value."""
    of_files: list[dict[str, Any]] = [
        {"seed": 0, "step": 20, "env_steps": "", "success_all": 0.3},
        {"seed": 1, "step": 20, "env_steps": 0, "success_all": 0.4},
        {"seed": 1, "step": 20, "env_steps": 100, "success_all": 0.8},
    ]
    times, values = on_a_grid(of_files, "success_all")
    assert times.tolist() == [0, 100] and values.tolist() == [[0.4, 0.8]]


@pytest.mark.parametrize("rate", [0.0, 0.26, 0.5, 0.95, 1.0])
def test_as_many_goals_as_an_interval_needs(rate: float) -> None:
    def reach(goals: int) -> float:
        reached = round(rate * goals)
        low, high = success_interval(reached, goals)
        return max(high - reached / goals, reached / goals - low)

    goals = PAGES.goals_for(rate, 0.05)
    assert reach(goals) <= 0.05 < reach(goals - 1)


def test_the_worth_of_alpha_by_hand() -> None:
    alphas: list[float | str] = [LEARNT, *ALPHAS]
    rows = [
        {
            "setting": "s",
            "task": "t",
            "seed": 0,
            "alpha": alpha,
            "goal": goal,
            "success": 1,
            "return": 3.0 if isinstance(alpha, str) else goal + alpha,
        }
        for alpha in alphas
        for goal in (0, 1)
    ]
    worth = {row["alpha"]: row for row in summarize_worth(rows)}
    assert worth[0.5]["difference"] == 2.0  # 3 - 0.5 and 3 - 1.5
    assert worth[0.5]["difference_interval"] == (1.5, 2.5)
    assert worth[0.5]["better_on"] == 2


def test_a_held_alpha_changes_nothing_else() -> None:
    """Nor does the agent see that it is held: its hand would move differently."""
    policy = LearnedPolicy(
        "ddpg", Ddpg(DdpgConfig(), make_task(), 0, (), REACH).agents, REACH
    )
    states = np.random.default_rng(0).normal(size=(2, 10))
    held = FixedAlpha(policy, 0.25)
    for _ in range(2):  # the second episode knows nothing of the first
        held.begin(np.random.default_rng(0), REACH)
        action = held.act(states[0])
        free = policy.act(states[0])
        assert action[3] == 0.25
        np.testing.assert_array_equal(action[:3], free[:3])
        unheld = states[1].copy()
        unheld[6] = free[3]
        np.testing.assert_array_equal(held.act(states[1])[:3], policy.act(unheld)[:3])


def test_the_learnt_alpha_is_compared_with_the_best_held_one() -> None:
    def rows(*returns: float) -> list[Row]:
        cells = product((0, 1), (0, 1))  # seeds and goals
        return [
            {"seed": seed, "goal": goal, "return": one}
            for (seed, goal), one in zip(cells, returns, strict=True)
        ]

    held = {0.0: rows(0, 0, 0, 0), 0.5: rows(1, 2, 1, 2), 1.0: rows(4, 0, 0, 0)}
    worth = worth_of_alpha(rows(2, 4, 1, 3), held)
    assert worth["best_held"] == 0.5
    assert worth["over_held"] == (1 + 2 + 0 + 1) / 4
    low, high = worth["over_held_interval"]
    assert low == pytest.approx(1 - 12.706 / 2, abs=1e-2)  # seeds: 1.5 and 0.5; t(1)
    assert high == pytest.approx(1 + 12.706 / 2, abs=1e-2)


def test_only_evaluations_that_differ_by_alpha_are_compared() -> None:
    """In whatever order a study has its probes."""
    probes = (
        Probe("half", "", alpha=0.5),
        LAST,
        Probe("zero", "", alpha=0.0),
        Probe("near", "", alpha=0.0, overrides={"success_distance": 0.2}),
    )
    setting = Setting("mabc", "MABC", "mabc")
    study = Study("x", [("good-5k", setting)], probes)
    returns = {"half": -5.0, "last": 0.0, "zero": -3.0, "near": -1.0}
    goals = {
        name: [
            {
                "seed": seed,
                "goal": goal,
                "success": 1,
                "direction": "",
                "return": goal + offset,
            }
            for seed, goal in product((0, 1), (0, 1))
        ]
        for name, offset in returns.items()
    }
    curves: list[Row] = [{"seed": seed, "step": 1} for seed in (0, 1)]
    rows = _by_probe(study, CellRows(study.cells[0], goals, curves, ""))
    assert {row["best_held"] for row in rows} == {0.0}
    assert {row["over_held"] for row in rows} == {3.0}


def test_a_goal_of_equal_return_is_no_better_one() -> None:
    head = {"setting": "s", "task": "t", "seed": 0, "success": 1}
    rows = [
        head | {"alpha": alpha, "goal": goal, "return": value}
        for alpha, values in ((LEARNT, (1.0, 2.0, 3.0)), (0.5, (1.0, 3.0, 2.0)))
        for goal, value in enumerate(values)
    ]
    (worth,) = summarize_worth(rows)
    assert worth["better_on"] == 1 and worth["difference"] == 0.0


def test_alpha_over_time_is_of_the_episodes_that_come_to_a_step(
    make_episode: Callable[..., Episode],
) -> None:
    episodes = []
    for number, alphas in ((1, (0.2, 0.4)), (3, (0.6, 0.8, 1.0))):  # both ahead
        episode = make_episode(number, steps=len(alphas))
        actions = episode.actions.copy()
        actions[:, 3] = alphas
        episodes.append(replace(episode, actions=actions))
    found = [(row["step"], row["episodes"], row["mean"]) for row in _steps(episodes)]
    expected = [(1, 2, 0.4), (2, 2, 0.6), (3, 1, 1.0)]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_interval_of_returns_is_over_seeds() -> None:
    """Two seeds of mean 1 and 3, however far apart their goals are: t(1) = 12.706."""
    rows = [
        {"seed": seed, "goal": goal, "direction": "", "success": 1, "return": value}
        for seed, values in enumerate(((0.0, 2.0), (2.5, 3.5)))
        for goal, value in enumerate(values)
    ]
    row = _of_probe(CellRows(DDPG.cells[0], {"last": rows}, [], ""), "last")
    assert row["return"] == 2.0
    np.testing.assert_allclose(
        row["return_interval"], (2 - 12.706, 2 + 12.706), atol=0.01
    )
