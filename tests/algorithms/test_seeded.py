"""Seeds side by side: each learns as if it were alone, whatever the team."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from marl_mm.algorithms.diagnostics import imitation_errors
from marl_mm.algorithms.networks import Normalizer, perceptron
from marl_mm.algorithms.seeded import (
    SeededActors,
    SeededCritics,
    load_parts,
    parts_state,
)
from marl_mm.envs.tasks.reach import LAYOUT
from marl_mm.layout import Layout

HAND, BALANCE = LAYOUT.team

SPLIT = replace(
    LAYOUT,
    team=(
        replace(BALANCE, name="outer", sets=("alpha", "delta_x")),
        replace(HAND, name="inner", sets=("delta_z", "delta_y")),
    ),
)
"""Agents whose entries are mixed in the joint action, and not in its order."""

SEEDS = (2, 5, 11)


def actors(seeds: tuple[int, ...], layout: Layout = LAYOUT) -> SeededActors:
    mean, std = torch.arange(10.0), torch.full((10,), 2.0)
    normalizer = Normalizer(mean, std)
    return SeededActors(layout.agents, normalizer, [8], 1e-2, seeds, "cpu")


def critics(seeds: tuple[int, ...], pairs: int = 1) -> SeededCritics:
    return SeededCritics(14, pairs, [8], True, 1e-2, seeds, "cpu")


def inputs(count: int, seeds: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """States and actions, the same for every seed."""
    draw = torch.Generator().manual_seed(0)
    state = torch.randn(1, count, 10, generator=draw).expand(seeds, -1, -1)
    action = torch.rand(1, count, 4, generator=draw).expand(seeds, -1, -1) * 2 - 1
    return state, action


def cloned(made: SeededActors, state: torch.Tensor, action: torch.Tensor) -> None:
    """One step of every agent towards actions."""
    for agent in made._layouts.values():
        own = made.action(agent.name, state) - action[..., list(agent.action)]
        made.descend(agent.name, own.square().mean(dim=(1, 2)))


@pytest.mark.parametrize("layout", [LAYOUT, SPLIT])
def test_seeds_side_by_side_learn_what_each_learns_alone(layout: Layout) -> None:
    together = actors(SEEDS, layout)
    for _ in range(5):
        cloned(together, *inputs(16, len(SEEDS)))
    for number, seed in enumerate(SEEDS):
        alone = actors((seed,), layout)
        for _ in range(5):
            cloned(alone, *inputs(16))
        state, _ = inputs(6)
        both = together.joint(inputs(6, len(SEEDS))[0])[number]
        torch.testing.assert_close(both, alone.joint(state)[0], atol=1e-6, rtol=0)


def valued(made: SeededCritics, state: torch.Tensor, action: torch.Tensor) -> None:
    """One step of all critics towards 0."""
    made.descend(made.values(state, action).square().mean(dim=(1, 2, 3)))


def test_critics_side_by_side_learn_what_each_learns_alone() -> None:
    """Every seed from transitions of its own."""
    draw = torch.Generator().manual_seed(1)
    state, action = (torch.randn(3, 16, n, generator=draw) for n in (10, 4))
    together = critics(SEEDS, 2)
    for _ in range(5):
        valued(together, state, action)
    every = together.values(state, action)
    for number, seed in enumerate(SEEDS):
        alone, own = critics((seed,), 2), slice(number, number + 1)
        for _ in range(5):
            valued(alone, state[own], action[own])
        torch.testing.assert_close(
            every[own], alone.values(state[own], action[own]), atol=1e-5, rtol=0
        )
        for mine, theirs in zip(together.state(number), alone.state(0), strict=True):
            for name, value in theirs.items():
                torch.testing.assert_close(mine[name], value, atol=1e-5, rtol=0)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_critics_are_perceptrons_of_state_and_action(layer_norm: bool) -> None:
    made = SeededCritics(14, 1, [8], layer_norm, 1e-2, SEEDS, "cpu")
    state, action = inputs(6, len(SEEDS))
    values = made.values(state, action)
    for number in range(len(SEEDS)):
        for twin, weights in enumerate(made.state(number)):
            alone = nn.Sequential(*perceptron((14, 8, 1), layer_norm=layer_norm))
            alone.load_state_dict(weights)
            expected = alone(torch.cat([state[0], action[0]], dim=-1)).squeeze(-1)
            torch.testing.assert_close(values[number, 0, twin], expected)


def test_the_joint_action_is_in_the_layouts_order() -> None:
    """However the agents share its entries."""
    made = actors(SEEDS, SPLIT)
    state, _ = inputs(6, len(SEEDS))
    joint = made.joint(state)
    for agent in SPLIT.agents:
        own = made.action(agent.name, state)
        assert torch.equal(joint[..., list(agent.action)], own)


def test_one_seeds_actors_act_as_the_ensemble_does() -> None:
    """On states that are not normalised yet: the statistics are within."""
    made = actors(SEEDS, SPLIT)
    raw = torch.randn(7, 10, generator=torch.Generator().manual_seed(1))
    normalised = ((raw - torch.arange(10.0)) / 2).expand(len(SEEDS), -1, -1)
    for number in range(len(SEEDS)):
        for name, agent in made.agents(number).items():
            with torch.no_grad():
                alone = agent.actor(agent.observed(raw))
            torch.testing.assert_close(alone, made.action(name, normalised)[number])


def test_states_come_back_and_learning_goes_on_equally() -> None:
    parts: dict[str, SeededActors | SeededCritics] = {
        "actors": actors(SEEDS),
        "critics": critics(SEEDS, 2),
    }
    parts |= {f"target_{name}": part.copy() for name, part in parts.items()}
    state, action = inputs(16, len(SEEDS))

    def learn(some: dict[str, SeededActors | SeededCritics]) -> None:
        made, judges = some["actors"], some["critics"]
        assert isinstance(made, SeededActors) and isinstance(judges, SeededCritics)
        cloned(made, state, action)
        valued(judges, state, action)

    learn(parts)
    kept = copy.deepcopy([parts_state(parts, n) for n in range(len(SEEDS))])
    fresh: dict[str, SeededActors | SeededCritics] = {
        "actors": actors((7, 8, 9)),
        "critics": critics((7, 8, 9), 2),
    }
    fresh |= {f"target_{name}": part.copy() for name, part in fresh.items()}
    load_parts(fresh, kept)
    learn(parts)
    learn(fresh)
    for number in range(len(SEEDS)):
        one, other = (parts_state(some, number) for some in (parts, fresh))
        assert (
            one.keys()
            == other.keys()
            == {"target_actors", "target_critics"}  # which do not learn
            | {"actors", "actor_learners", "critics", "critic_learners"}
        )
        for part in ("actors", "target_actors"):
            for name, weights in one[part]["balance"].items():
                assert torch.equal(weights, other[part]["balance"][name])
        for part in ("critics", "target_critics"):
            for mine, theirs in zip(one[part], other[part], strict=True):
                assert all(torch.equal(mine[key], theirs[key]) for key in mine)


def test_targets_stay_until_they_are_told_to_follow() -> None:
    made, judges = actors(SEEDS), critics(SEEDS)
    targets, judged = made.copy(), judges.copy()
    state, action = inputs(8, len(SEEDS))
    before, worth = made.joint(state), judges.values(state, action)
    cloned(made, state, action)
    valued(judges, state, action)
    assert torch.equal(targets.joint(state), before)
    assert torch.equal(judged.values(state, action), worth)
    flats = [
        (targets.networks["balance"].flat, made.networks["balance"].flat),
        (judged.networks.flat, judges.networks.flat),
    ]
    expected = [(0.75 * old + 0.25 * new) for old, new in flats]
    targets.follow(made, 0.25)
    judged.follow(judges, 0.25)
    for (found, new), value in zip(flats, expected, strict=True):
        assert not torch.equal(value, new)
        torch.testing.assert_close(found, value, atol=1e-7, rtol=0)
    targets.follow(made, 1.0)
    judged.follow(judges, 1.0)
    assert torch.equal(targets.joint(state), made.joint(state))
    assert torch.equal(judged.values(state, action), judges.values(state, action))
    assert not (targets.learns or judged.learns) and made.learns and judges.learns


def test_pairs_of_critics_are_independent() -> None:
    """Of other weights; ``first`` and ``least`` are of one pair."""
    judges = critics(SEEDS, pairs=2)
    state, action = inputs(5, len(SEEDS))
    values = judges.values(state, action)
    assert values.shape == (3, 2, 2, 5)
    assert len({tuple(v.flatten().tolist()) for v in values.flatten(0, 2)}) == 12
    for pair in range(2):
        first = judges.first(state, action, pair)
        torch.testing.assert_close(first, values[:, pair, 0])
    assert torch.equal(judges.least(state, action), values.amin(dim=2))


def test_weights_follow_from_the_seed_alone() -> None:
    torch.manual_seed(1)
    one = actors((3,)).joint(inputs(4)[0])
    torch.manual_seed(2)
    torch.randn(7)
    before = torch.get_rng_state()
    assert torch.equal(actors((3,)).joint(inputs(4)[0]), one)
    assert torch.equal(torch.get_rng_state(), before)


def test_no_actor_begins_with_a_critics_weights() -> None:
    """Nor with those of another seed: all first layers, of the same shape, differ."""
    blank, seeds = Normalizer.blank(10), range(4)
    made = SeededActors((LAYOUT.joint,), blank, [8], 1e-2, seeds, "cpu")
    judges = SeededCritics(10, 1, [8], False, 1e-2, seeds, "cpu")
    first = [made.networks["joint"].member(n)["0.weight"] for n in seeds]
    first += [one["0.weight"] for n in seeds for one in judges.state(n)]
    assert len({tuple(weight.flatten().tolist()) for weight in first}) == 12


def test_imitation_errors_are_by_entry_and_worked_by_hand() -> None:
    action = torch.zeros(1, 2, 4)
    now = torch.tensor([[[1.0, 0, 0, 0.5], [-1.0, 0, 0.2, 0.5]]])
    errors = imitation_errors(now, action, LAYOUT)
    found = {name.removeprefix("imitation/"): v.item() for name, v in errors.items()}
    expected = {"delta_x": 1.0, "delta_y": 0.0, "delta_z": 0.02, "alpha": 0.25}
    np.testing.assert_allclose([found[name] for name in expected], [*expected.values()])
    assert found["action/saturation"] == 0.25
