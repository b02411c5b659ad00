"""What choosing a policy costs in episodes, and what scores of data alone are worth."""

import json
import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.budgets import (
    BUDGETS,
    BUDGETS_FIGURE,
    BUDGETS_TABLE,
    SELECTION_TABLE,
    deviation_of_found,
    draw_budgets,
    expected_best,
    found,
)

RATES = np.array([0.1, 0.3, 0.9, 0.5])


def test_a_bandit_begins_at_random_and_ends_with_the_best() -> None:
    curve = found(RATES, 200)
    assert curve.shape == (500, 201)
    assert curve[:, 0].mean() == pytest.approx(RATES.mean(), abs=0.05)
    assert (curve[:, 200] == 0.9).mean() > 0.95
    np.testing.assert_array_equal(curve, found(RATES, 200))


def test_a_bandit_is_ucb1() -> None:
    """Step by step: first who has not acted yet, then the highest bound."""
    episodes = 40
    rng = np.random.default_rng(0)
    order = rng.permuted(np.tile(RATES, (500, 1)), axis=1)
    luck = rng.random((episodes, 500))
    for bandit, curve in enumerate(found(RATES, episodes)[:20]):
        rates, counts, reached = order[bandit], [0] * 4, [0] * 4
        for number in range(1, episodes + 1):
            bounds = [
                won / count + math.sqrt(2 * math.log(number) / count) if count else 99
                for won, count in zip(reached, counts, strict=True)
            ]
            arm = bounds.index(max(bounds))
            counts[arm] += 1
            reached[arm] += luck[number - 1, bandit] < rates[arm]
            means = [
                won / count if count else -1
                for won, count in zip(reached, counts, strict=True)
            ]
            assert curve[number] == rates[means.index(max(means))]


def test_of_one_that_always_and_one_that_never_succeeds_two_episodes_tell() -> None:
    assert (found(np.array([0.0, 1.0, 0.0]), 5)[:, 3:] == 1.0).all()


def test_policies_that_are_alike_cost_nothing_to_choose() -> None:
    assert (found(np.full(6, 0.4), 20) == 0.4).all()


def test_the_deviation_is_that_of_the_settings() -> None:
    """Before any episode it is that of their mean; there is none of those alike."""
    rates = np.linspace(0, 1, 24)[:, None].repeat(2, axis=1)
    deviation = rates.std() / np.sqrt(24)
    assert deviation_of_found(rates, 3)[0] == pytest.approx(deviation, rel=0.25)
    assert deviation_of_found(np.full((6, 2), 0.4), 3) == pytest.approx(0, abs=1e-9)


def test_a_critic_is_compared_at_one_discount_only(tmp_path: Path) -> None:
    """Values of a larger discount are larger, whoever is better."""
    rows = [
        {
            **{"dataset": "d", "algorithm": "iql", "success": rate},
            **{"cloning": rate, "critic": rate + 100 * discount},
            "changes": json.dumps({"discount": discount}),
        }
        for discount, share in ((0.9, 1.0), (0.99, 0.1))
        for rate in share * RATES
    ]
    draw_budgets(rows, "mujoco 4.0.0", tmp_path)
    cloning, critic = read_rows(tmp_path / SELECTION_TABLE)
    assert cloning["groups"] == 1
    assert np.isnan(critic["correlation"]) and critic["groups"] == 2
    assert critic["correlation_within"] == 1.0 and critic["regret_within"] == 0.0


@pytest.mark.parametrize("rates", [RATES, np.array([0.0, 0.0, 0.0, 0.1])])
def test_intervals_are_of_95_percent_within_all_goals_and_none(
    rates: np.ndarray, tmp_path: Path
) -> None:
    rows = [
        {
            **{"dataset": "d", "algorithm": "iql", "success": rate},
            "changes": json.dumps({"setting": number}),
        }
        for number, rate in enumerate(rates.tolist())
    ]
    draw_budgets(rows, "mujoco 4.0.0", tmp_path)
    deviation = deviation_of_found(rates[:, None], BUDGETS[-1])
    for row in read_rows(tmp_path / BUDGETS_TABLE):
        mean, reach = row["success"], 1.96 * deviation[row["episodes"]]
        ends = max(0.0, mean - reach), min(1.0, mean + reach)
        assert row["success_interval"] == pytest.approx(ends, abs=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_expected_best_is_the_mean_over_all_draws(count: int) -> None:
    draws = [max(drawn) for drawn in product(RATES, repeat=count)]
    assert expected_best(RATES, count) == pytest.approx(np.mean(draws))


def test_a_score_like_success_chooses_the_best_and_its_opposite_the_worst(
    tmp_path: Path,
) -> None:
    rows = [
        {
            **{"dataset": "tray-noisy", "algorithm": name, "success": rate},
            **{"cloning": rate**3, "fqe": -rate, "fqe_agents": 0.0, "critic": np.nan},
            "changes": "{}",
        }
        for name, rates in (("bc", RATES), ("iql", RATES / 2))
        for rate in rates
    ]
    draw_budgets(rows, "mujoco 4.0.0", tmp_path)
    cloning, fqe, agents = read_rows(tmp_path / SELECTION_TABLE)
    assert cloning["correlation"] == cloning["correlation_within"] == 1.0
    assert cloning["regret"] == cloning["regret_within"] == 0.0
    assert fqe["correlation"] == fqe["correlation_within"] == -1.0
    assert fqe["regret"] == pytest.approx(0.85)
    assert fqe["regret_within"] == pytest.approx((0.8 + 0.4) / 2)
    chance = RATES.max() - RATES.mean()
    assert fqe["regret_random_within"] == pytest.approx(chance * 1.5 / 2)
    assert fqe["regret_random"] == pytest.approx(RATES.max() - 0.75 * RATES.mean())
    assert np.isnan(agents["correlation"]) and agents["policies"] == 8
    budgets = read_rows(tmp_path / BUDGETS_TABLE)
    assert [row["episodes"] for row in budgets] == [*BUDGETS, *BUDGETS]
    assert budgets[0]["best"] == 0.9 and budgets[-1]["best"] == 0.45
    assert (tmp_path / BUDGETS_FIGURE).exists()
