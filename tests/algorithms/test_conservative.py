"""OMAR, CFCQL, CQL and MAICQ: games solved by hand, and their losses."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from marl_mm.algorithms.cfcql import nearness_to_bounds
from marl_mm.algorithms.iql import LARGEST_WEIGHT
from marl_mm.algorithms.registry import ALGORITHMS, TUNED
from marl_mm.contracts.learners import (
    UNUSUAL,
    Candidate,
    candidate,
    several_layouts,
    some_episodes,
)
from marl_mm.datasets.arrays import EpisodeArrays
from tests.algorithms.games import NoJudge, steps_of, team
from tests.algorithms.test_teams import XOR, conventions

GENTLE: dict[str, Any] = {"conservatism": 0.05, "learning_rate": 2e-3}
"""Settings for rewards of about 1, a tenth of those of the package's tasks."""

QUICK: dict[str, Any] = {"learning_rate": 2e-3}


def trained(
    name: str,
    arrays: EpisodeArrays,
    updates: int,
    seeds: tuple[int, ...] = (0, 1),
    **changes: Any,
) -> Any:
    """A learner of small networks after some updates on a game."""
    small: dict[str, Any] = {
        "hidden": (32, 32),
        "batch_size": 64,
        "precision": "highest",
    }
    algorithm = ALGORITHMS.get(name)
    config = replace(algorithm.presets[TUNED], **small | changes)
    learner = algorithm.learner(config, arrays, NoJudge(), seeds, "cpu")
    for _ in range(updates):
        learner.update()
    return learner


def acted(learner: Any) -> np.ndarray:
    """Every seed's joint action where games begin, shape (S, k)."""
    state = torch.zeros(len(learner.seeds), 1, 2)
    with torch.no_grad():
        return np.asarray(learner.actors.joint(learner.normalizer(state))[:, 0])


def valued(learner: Any, *actions: Any, place: float = 0.0) -> np.ndarray:
    """Least values of joint actions by every seed, shape (S, actions)."""
    asked = torch.tensor([actions]).expand(len(learner.seeds), -1, -1)
    state = torch.tensor([place, 0.0]).expand(*asked.shape[:2], 2)
    with torch.no_grad():
        return np.asarray(learner.critics.least(learner.normalizer(state), asked)[:, 0])


def test_nearness_to_bounds_is_finite_at_them() -> None:
    near = nearness_to_bounds(torch.tensor([[0.0, 0.6], [0.0, 0.0], [-1.0, 0.0]]))
    np.testing.assert_allclose(near, [-np.log(0.64), 0.0, 13.8], atol=0.1)


# --- Games -------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [("cql", GENTLE), ("cfcql", GENTLE), ("omar", GENTLE), ("maicq", QUICK)],
)
def test_the_better_convention_is_kept(name: str, changes: Any) -> None:
    learner = trained(name, conventions(rewards=(1.0, 0.0)), 400, **changes)
    np.testing.assert_allclose(acted(learner), [XOR[0], XOR[0]], atol=0.2)


def quadratic() -> EpisodeArrays:
    """Random actions of two agents, best if equal and of sum 1."""
    actions = np.random.default_rng(0).uniform(-1, 1, (2_000, 2))
    miss, apart = actions.sum(axis=1) - 1, actions[:, 0] - actions[:, 1]
    return steps_of(actions, -np.square(miss) - 0.1 * np.square(apart), team())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["cql", "cfcql", "omar", "cal-ql", "ma-cal-ql", "rlpd", "ma-rlpd"]
)
def test_critics_lead_a_team_to_its_best_actions(name: str) -> None:
    settings = QUICK if "rlpd" in name else GENTLE
    actions = acted(trained(name, quadratic(), 450, **settings))
    np.testing.assert_allclose(actions.sum(axis=1), 1.0, atol=0.3)
    np.testing.assert_allclose(actions, 0.5, atol=0.35)


@pytest.mark.slow
def test_an_agent_that_suits_the_data_s_others_misses_the_team_s_best() -> None:
    """Each one's best against uniform actions of the other is 1 / 1.1."""
    learner = trained("cfcql", quadratic(), 450, **GENTLE, others="data")
    np.testing.assert_allclose(acted(learner), 1 / 1.1, atol=0.12)


@pytest.mark.slow
def test_agents_that_learn_in_turn_suit_each_other() -> None:
    """The second one makes up for what the first does, although data do not."""
    actions = acted(trained("maicq", quadratic(), 450, **QUICK))
    np.testing.assert_allclose(actions.sum(axis=1), 1.0, atol=0.1)


@pytest.mark.slow
def test_a_search_leaves_the_lower_of_two_hills() -> None:
    """From 0 the gradient leads to the broad one; the narrow one is higher."""
    action = np.random.default_rng(0).uniform(-1, 1, (2_000, 1))
    broad = 0.6 * np.exp(-np.square((action + 0.5) / 0.4))
    narrow = np.exp(-np.square((action - 0.7) / 0.2))
    data = steps_of(action, (broad + narrow)[:, 0], team(1))
    settings: dict[str, Any] = {"conservatism": 0.05, "learning_rate": 1e-3}
    for name, top in (("cfcql", -0.5), ("omar", 0.7)):
        learner = trained(name, data, 500, **settings)
        np.testing.assert_allclose(acted(learner), top, atol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("weight", "best"), [(0.0, 1.0), (0.5, 0.618)])
def test_actions_pay_for_being_near_their_bounds(weight: float, best: float) -> None:
    """Of a reward a the best has 1 = 2 b a / (1 - a^2): with b = 0.5 the golden one."""
    action = np.random.default_rng(0).uniform(-1, 1, (2_000, 1))
    data = steps_of(action, action[:, 0], team(1))
    settings: dict[str, Any] = {"conservatism": 0.02, "learning_rate": 1e-3}
    learner = trained("cfcql", data, 500, **settings, bound_penalty=weight)
    np.testing.assert_allclose(acted(learner), best, atol=0.12)


@pytest.mark.slow
@pytest.mark.parametrize(("temperature", "share"), [(0.05, 1.0), (1e6, 0.5)])
def test_the_next_step_is_worth_its_weighted_mean(
    temperature: float, share: float
) -> None:
    """A second step is worth 1 or 0, as often; nothing is paid for the first."""
    second = np.arange(100) % 2
    actions = np.stack([np.zeros((100, 2)), XOR[second]], axis=1).reshape(-1, 2)
    rewards = np.stack([np.zeros(100), 1.0 - second], axis=1).ravel()
    settings: dict[str, Any] = QUICK | {"critic_temperature": temperature}
    data = steps_of(actions, rewards, team(), length=2)
    learner = trained("maicq", data, 400, **settings, target_rate=0.05)
    expected = np.full((2, 1), 0.95 * share)
    np.testing.assert_allclose(valued(learner, [0.0, 0.0]), expected, atol=0.1)


# --- Values outside of the data ----------------------------------------------

INSIDE = [0.5, 0.5]
"""Actions of both agents in the data, but for a little noise."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cql", "cfcql"])
def test_values_outside_of_the_data_are_below_those_inside(name: str) -> None:
    spread = 0.05 * np.random.default_rng(0).standard_normal((500, 2))
    data = steps_of(np.array(INSIDE) + spread, np.ones(500), team())
    outside = [[-0.5, 0.5], [0.5, -0.5]]
    if name == "cql":  # CFCQL says nothing of teams all of whom leave the data
        outside += [[-0.5, -0.5]]
    gaps = {}
    for conservatism in (0.0, 1.0):
        learner = trained(name, data, 150, **QUICK, conservatism=conservatism)
        values = valued(learner, INSIDE, *outside)
        gaps[conservatism] = values[:, :1] - values[:, 1:]
    assert (gaps[1.0] > 0.5).all(), gaps
    assert (gaps[1.0] > gaps[0.0] + 0.3).all(), gaps


def quick(name: str, **changes: Any) -> Candidate:
    """A candidate whose preset is changed."""
    algorithm = ALGORITHMS.get(name)
    config = replace(algorithm.presets[TUNED], **changes)
    return Candidate(name, replace(algorithm, presets={TUNED: config}))


def network(weights: Any, inputs: np.ndarray) -> np.ndarray:
    """Outputs of a critic of one hidden layer, shapes (n, d) to (n,)."""
    w = {key: value.numpy() for key, value in weights.items()}
    hidden = inputs @ w["0.weight"].T + w["0.bias"]
    hidden = hidden - hidden.mean(axis=1, keepdims=True)
    hidden /= np.sqrt(np.square(hidden).mean(axis=1, keepdims=True) + 1e-5)
    hidden = np.maximum(hidden * w["1.weight"] + w["1.bias"], 0.0)
    return np.asarray((hidden @ w["3.weight"].T + w["3.bias"])[:, 0])


@pytest.mark.parametrize("name", ["cql", "cfcql", "omar"])
def test_the_conservative_term_is_the_one_worked_by_hand(name: str) -> None:
    arrays = several_layouts(some_episodes())[UNUSUAL]
    tested = quick(name, penalized=5, samples=3)
    learner, seed = tested.fresh(arrays, (3, 4)), 1
    batch = learner._batches.next()
    state = learner.normalizer(batch.observation)[seed, :5].numpy()
    action, noise = batch.action[seed, :5].numpy(), batch.extra[seed, :5].numpy()
    with torch.no_grad():
        now = learner.actors.joint(learner.normalizer(batch.observation))
    now = now[seed, :5].numpy()
    focus, spread = learner.config.focus, learner.config.sample_noise
    width, total = action.shape[1], 0.0
    for weights in learner.critics.state(seed):
        for row in range(5):
            drawn = noise[row, : 6 * width].reshape(6, width)
            softs, away = [], []
            for agent in learner.layouts:
                own = list(agent.action)
                summed = 0.0
                for number, each in enumerate(drawn):
                    joint = action[row].copy()
                    if number < 3:
                        uniform = [0.5 * (1 + math.erf(x / 2**0.5)) for x in each[own]]
                        joint[own] = 2 * np.array(uniform) - 1
                        density = 0.5 ** len(own)
                    else:
                        joint[own] = now[row, own] + spread * each[own]
                        scale = spread * math.sqrt(2 * math.pi)
                        density = np.prod(np.exp(-np.square(each[own]) / 2) / scale)
                    joint = joint.clip(-1, 1)
                    inputs = np.concatenate([state[row], joint])[None]
                    summed += math.exp(network(weights, inputs)[0]) / density
                softs.append(math.log(summed / 6))
                away.append(np.square(now[row, own] - action[row, own]).sum())
            share = np.exp(focus * np.array(away))
            share /= share.sum()
            inputs = np.concatenate([state[row], action[row]])[None]
            total += (share @ softs - network(weights, inputs)[0]) / 5
    logged = tested.fresh(arrays, (3, 4)).update()["loss/conservative"]
    assert logged[seed].item() == pytest.approx(total, rel=1e-4)


# --- Steps that are not imitated ---------------------------------------------


def test_targets_are_the_lower_of_two_critics_other_ones_each_time() -> None:
    learner = quick("rlpd", critics=4).fresh(some_episodes())
    chosen = set()
    for _ in range(60):
        batch = learner._batches.next()
        state = learner.normalizer(batch.next_observation)
        value = learner._next_value(state, batch.action, batch)[0, 0]
        each = learner._target_critics.values(state, batch.action)[0].flatten(0, 1)
        pairs = [
            (i, j)
            for i in range(4)
            for j in range(i)
            if torch.equal(value, torch.minimum(each[i], each[j]))
        ]
        assert pairs
        chosen |= set(pairs) if len(pairs) == 1 else set()
    assert len(chosen) == 6


@pytest.mark.parametrize("bound", ["none", "high"])
def test_a_calibrated_term_presses_no_value_below_the_return(bound: str) -> None:
    """Where no return bounds it, it is CQL's; where all do, policies count as them."""
    cal, cql = (quick(name) for name in ("cal-ql", "cql"))
    states = several_layouts(some_episodes())["one agent"]
    learners = [c.fresh(states) for c in (cal, cql)]
    batch = learners[0]._batches.next()
    state = learners[0].normalizer(batch.observation)[:, :16]
    rest = torch.full_like(batch.rest, -1e6 if bound == "none" else 50.0)
    ours, theirs = (
        learner._excess(state, batch._replace(rest=rest)) for learner in learners
    )
    if bound == "none":
        assert torch.equal(ours, theirs)
    else:
        config = learners[0].config
        width = batch.action.shape[-1]
        spread = config.sample_noise * math.sqrt(2 * math.pi)
        least = math.log(spread) * width + 50 - math.log(2)
        assert (ours > least).all() and (theirs < 50 + math.log(spread) * width).all()


def test_actions_for_other_goals_teach_critics_only() -> None:
    elsewhere = quick("maicq", elsewhere=1.0)
    learner = elsewhere.fresh(some_episodes())
    before = elsewhere.weights(learner)
    elsewhere.train(learner)
    for key, value in elsewhere.weights(learner).items():
        np.testing.assert_array_equal(value, before[key])
    conservative = quick("cfcql", elsewhere=1.0).fresh(some_episodes())
    assert conservative.update()["loss/conservative"].item() == 0.0


def test_one_agent_that_sees_all_is_improved_like_cql() -> None:
    """Whatever its focus and its others, of whom there are none."""
    alone = several_layouts(some_episodes())["one agent"]
    team_of_one = quick("cfcql", focus=7.0, others="data").trained(alone)
    joint = candidate("cql").trained(alone)
    for here, there in zip(
        team_of_one.actors.networks.values(),
        joint.actors.networks.values(),
        strict=True,
    ):
        assert torch.equal(here.flat, there.flat)


@pytest.mark.parametrize("name", ["cql", "omar"])
def test_actions_pay_for_their_mean_square(name: str) -> None:
    """Before anybody has learnt, critics and actors of both are the same."""
    free, paying = (
        quick(name, policy_delay=1, action_penalty=weight).fresh(some_episodes())
        for weight in (0.0, 100.0)
    )
    state = free.normalizer(quick(name).fresh(some_episodes())._batches.next()[0])
    losses = [learner.update() for learner in (free, paying)]
    fresh = quick(name).fresh(some_episodes()).actors
    for agent in free.layouts:
        square = fresh.action(agent.name, state).square().mean()
        before, after = (each[f"loss/{agent.name}"] for each in losses)
        assert (after - before).item() == pytest.approx(100 * square.item(), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "taught"),
    [
        ("iql", {"critic", "value"}),
        ("best-of-n", {"critic", "value"}),
        ("fql", {"critic", "joint"}),
    ],
)
def test_no_actor_or_flow_imitates_actions_for_other_goals(
    name: str, taught: set[str]
) -> None:
    losses = quick(name, elsewhere=1.0).fresh(some_episodes()).update()
    assert {key for key in losses if losses[key].any()} == {f"loss/{n}" for n in taught}


def test_no_step_weighs_more_than_the_largest_weight() -> None:
    """However good it is; no square error of two actions in [-1, 1] is above 4."""
    losses = quick("iql", temperature=1e6).fresh(some_episodes()).update()
    assert 1.0 < losses["loss/joint"].item() <= 4 * LARGEST_WEIGHT
