"""Updates of algorithms are those of d3rlpy 2.8.1, an implementation by others.

``fixtures/make_d3rlpy_updates.py`` made what they are compared with: weights, batches,
and what d3rlpy learnt. Both start anew from the same weights, without moments of Adam,
whose first step hardly tells how long a gradient is; so there are four updates.

What is set here so that definitions are the same: critics without normalised layers,
targets without a bound, all actions imitated, and TD3+BC as in its paper. IQL's steps
are in our order, and its actor is ours, see there. ReBRAC needs nothing. Of CQL one
step of the critics is compared: its actor is another, and its actions are drawn there.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED
from marl_mm.layout import JOINT_NAME, Agent, Entry, Layout
from tests.algorithms.games import NoJudge, steps_of

MADE = np.load(Path(__file__).parents[1] / "fixtures" / "d3rlpy_updates.npz")
UPDATES, SIZE, STATES = MADE["batch/observation"].shape
ACTIONS = MADE["batch/action"].shape[2]
HIDDEN = (12, 12)
GIVEN = (
    *("observation", "action", "reward", "next_observation", "next_action"),
    *("terminated", "noise"),
)
RATE = 3e-3
WITH_CRITICS: dict[str, Any] = {
    "discount": 0.9,
    "target_rate": 0.05,
    "layer_norm": False,
    "clip_targets": False,
}
SETTINGS: dict[str, dict[str, Any]] = {
    "bc": {"learning_rate": RATE},
    "td3-bc": {
        "actor_learning_rate": RATE,
        "critic_learning_rate": RATE,
        "q_weight": 2.5,
        "target_noise": 0.4,
        **WITH_CRITICS,
    },
    "iql": {
        "learning_rate": RATE,
        "expectile": 0.8,
        "temperature": 10.0,
        **WITH_CRITICS,
    },
    "rebrac": {
        "learning_rate": RATE,
        "actor_weight": 0.3,
        "critic_weight": 0.7,
        "target_noise": 0.4,
        **WITH_CRITICS,
    },
    "cql": {
        "learning_rate": RATE,
        "conservatism": 2.0,
        "samples": 6,
        "target_noise": 0.0,
        **WITH_CRITICS,
    },
}
"""Hyper-parameters as the fixture has them."""

LOSSES = {
    "critic": ("loss/critic",),
    "value": ("loss/value",),
    "actor": ("loss/actor", f"loss/{JOINT_NAME}"),
    "imitation": ("loss/imitation", f"loss/imitation/{JOINT_NAME}"),
}
"""What algorithms call their losses."""


def layout() -> Layout:
    """One agent that sees and sets everything."""
    state = tuple(Entry(f"s_{i}", "m") for i in range(STATES))
    action = tuple(Entry(f"a_{i}", "1", -1.0, 1.0) for i in range(ACTIONS))
    names = tuple(e.name for e in state), tuple(e.name for e in action)
    return Layout(state, action, (Agent("all", *names),), ("s_0",), ("s_1",))


def begun(name: str, **changes: Any) -> Any:
    """A learner with the fixture's weights, which meets the fixture's batches."""
    algorithm = ALGORITHMS.get(name)
    usual = algorithm.presets.get(PAPER, algorithm.presets[TUNED])
    settings = SETTINGS[name] if name in SETTINGS else {}
    config = replace(usual, hidden=HIDDEN, batch_size=SIZE, **settings | changes)
    arrays = steps_of(np.zeros((8, ACTIONS)), np.zeros(8), layout())
    arrays = replace(arrays, states=np.zeros((16, STATES)))
    learner = algorithm.learner(config, arrays, NoJudge(), (0,), "cpu")
    mean, std = (torch.from_numpy(MADE[f"batch/{name}"]) for name in ("mean", "std"))
    learner.normalizer.set(mean, std)
    state = learner.state(0)
    for key in {"actors", "target_actors"} & state.keys():
        loaded = weights(f"before/{key.removesuffix('s')}", STATES, ACTIONS)
        state[key][JOINT_NAME] |= {f"layers.{k}": v for k, v in loaded.items()}
    for key, prefix in (("critics", ""), ("target_critics", "target_")):
        if key in state:
            paths = [f"before/{prefix}critic_{i}" for i in range(2)]
            state[key] = [weights(path, STATES + ACTIONS, 1) for path in paths]
    if "values" in state:
        state["values"] = [weights("before/value", STATES, 1)]
    learner.load_states([state])
    drawn = learner._batches.next()  # for what the fixture does not have
    batches = [drawn._replace(**batch(number)) for number in range(UPDATES)]
    learner._batches._drawn, learner._batches._taken = batches, 0
    return learner


def weights(path: str, inputs: int, outputs: int) -> dict[str, torch.Tensor]:
    """State of one of the fixture's networks."""
    first, second = HIDDEN
    layers = nn.Linear(inputs, first), nn.ReLU(), nn.Linear(first, second), nn.ReLU()
    network = nn.Sequential(*layers, nn.Linear(second, outputs))
    flat = torch.from_numpy(MADE[path])
    assert len(flat) == sum(p.numel() for p in network.parameters())
    nn.utils.vector_to_parameters(flat, network.parameters())
    return network.state_dict()


def batch(number: int) -> dict[str, torch.Tensor]:
    """One of the fixture's batches, by the names of ``OfflineBatch``."""
    given = {k: MADE[f"batch/{k}"][number] for k in GIVEN}
    given |= {"imitated": np.ones(SIZE), "successful": np.ones(SIZE)}
    return {k: torch.from_numpy(v).float()[None] for k, v in given.items()}


def learnt(learner: Any) -> dict[str, np.ndarray]:
    """Weights by the fixture's names."""
    state = learner.state(0)
    found = {}
    for key in {"actors", "target_actors"} & state.keys():
        actor = state[key][JOINT_NAME]
        layers = [value for name, value in actor.items() if "layers." in name]
        found[key.removesuffix("s")] = flat(layers)
    for key in {"critics", "target_critics"} & state.keys():
        name = key.removesuffix("s")
        pairs = enumerate(state[key])
        found |= {f"{name}_{i}": flat(critic.values()) for i, critic in pairs}
    if "values" in state:
        found["value"] = flat(state["values"][0].values())
    return found


def flat(values: Any) -> np.ndarray:
    return np.concatenate([value.numpy().ravel() for value in values])


@pytest.mark.parametrize("name", ("bc", "td3-bc", "iql", "rebrac"))
def test_updates_are_those_of_others(name: str) -> None:
    learner = begun(name)
    losses = []
    for number in range(1, UPDATES + 1):
        losses.append(learner.update())
        if number not in (1, UPDATES):
            continue
        found = learnt(learner)
        prefix = f"{name}/after_{number}/"
        expected = {k.removeprefix(prefix) for k in MADE if k.startswith(prefix)}
        assert expected == found.keys()
        for key, value in found.items():
            np.testing.assert_allclose(
                value, MADE[prefix + key], atol=1e-5, rtol=0, err_msg=f"{number} {key}"
            )
    for loss in (k for k in MADE if k.startswith(f"{name}/loss/")):
        (key,) = [k for k in LOSSES[loss.rpartition("/")[2]] if k in losses[-1]]
        there = [each[key].item() if key in each else np.nan for each in losses]
        np.testing.assert_allclose(there, MADE[loss], rtol=1e-5, err_msg=loss)


def test_conservative_critics_are_those_of_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With d3rlpy's actions and their densities; it does not take off the logarithm of
    their number, and its targets follow the actor itself."""
    learner = begun("cql")
    learner._target_actors.follow(learner.actors, 1.0)
    drawn = torch.from_numpy(MADE["cql/drawn"])[None]
    density = torch.from_numpy(MADE["cql/log_density"])[None, ..., None]
    entries = (density / ACTIONS).expand(drawn.shape)
    monkeypatch.setattr(learner, "_drawn", lambda *_: (drawn, entries))
    losses = learner.update()
    found = learnt(learner)
    for key in ("critic_0", "critic_1"):
        np.testing.assert_allclose(
            found[key], MADE[f"cql/after_1/{key}"], atol=1e-5, rtol=0, err_msg=key
        )
    excess = losses["loss/conservative"].item() + 2 * np.log(drawn.shape[1])
    weighed = learner.config.conservatism * excess
    assert weighed == pytest.approx(MADE["cql/loss/conservative"], rel=1e-5)
    whole = losses["loss/critic"].item() + weighed
    assert whole == pytest.approx(MADE["cql/loss/critic"], rel=1e-5)
