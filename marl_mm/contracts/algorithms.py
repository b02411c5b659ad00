"""Claims that hold of every algorithm, offline and online."""

import json
import math
import pickle
import random
import tempfile
import warnings
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import read_checkpoint
from marl_mm.algorithms.export import (
    TOLERANCE,
    export_policy,
    largest_difference,
)
from marl_mm.algorithms.online import OnlineAlgorithm
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.contracts.claims import Claim, demand, demand_refused, demand_same
from marl_mm.contracts.episodes import demand_inside
from marl_mm.contracts.learners import (
    UNUSUAL,
    UPDATES,
    Candidate,
    demand_same_state,
    several_layouts,
    some_episodes,
)
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.policy import Policy

SHOWN, SHOWN_ONLINE = 60, 100
"""Updates after which an actor follows the data, offline and online."""

PAY = 4.0
"""Reward online for an entry of the action at its bound."""

_CLOSE = 1e-5
"""Tolerance of weights that learnt alone and beside others, absolute and relative."""


def _names(candidate: Candidate) -> None:
    for preset, config in candidate.algorithm.presets.items():
        how = getattr(config, "__dataclass_params__", None)
        demand(
            how is not None and how.frozen, f"preset {preset} is no frozen dataclass"
        )
        json.dumps(asdict(config))
    learner = candidate.fresh(some_episodes())
    missing = _members(OnlineAlgorithm if candidate.online else OfflineAlgorithm)
    missing = {name for name in missing if not hasattr(learner, name)}
    demand(not missing, f"the learner has no {', '.join(sorted(missing))}")
    demand(learner.name == candidate.name, f"the learner calls itself {learner.name!r}")


def _members(protocol: type) -> set[str]:
    """Names of a protocol's public members, inherited ones included."""
    parts = (base for base in protocol.__mro__ if getattr(base, "_is_protocol", False))
    names = {name for base in parts for name in {*vars(base), *base.__annotations__}}
    return {name for name in names if not name.startswith("_")}


def _seeds(candidate: Candidate) -> None:
    torch.manual_seed(1)
    first = candidate.trained(some_episodes())
    torch.manual_seed(2)
    again = candidate.trained(some_episodes())
    other = candidate.trained(some_episodes(), (1,))
    demand_same_state(candidate.state(first), candidate.state(again))
    here, there = candidate.weights(first), candidate.weights(other)
    differ = any(not np.array_equal(here[key], there[key]) for key in here)
    demand(differ, "two seeds learn the same")


def _resumes(candidate: Candidate) -> None:
    straight = candidate.trained(some_episodes())
    if not candidate.online and hasattr(straight, "observe"):
        straight.observe(some_episodes(), 0.5)
        own = straight.own
        demand(min(own) > 0, f"it counts {own[0]} own episodes of {own[1]} steps")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "checkpoint.pt")
        candidate.save(path, straight)
        candidate.train(straight)
        state = read_checkpoint(path, candidate.name)["state"]
    resumed = candidate.fresh(some_episodes())
    if candidate.online:
        resumed.load_state(state)
    else:
        resumed.load_states([state])
        demand(resumed.step == UPDATES, f"it resumes at update {resumed.step}")
    candidate.train(resumed)
    for count in ("episodes", "env_steps", "updates") if candidate.online else ():
        here, there = getattr(straight, count), getattr(resumed, count)
        demand(here == there, f"{count} are {here}, resumed {there}")
    demand_same_state(candidate.state(straight), candidate.state(resumed))


def _side_by_side(candidate: Candidate) -> None:
    together = candidate.trained(some_episodes(), (3, 5))
    for number, seed in enumerate((3, 5)):
        alone = candidate.trained(some_episodes(), (seed,))
        both = candidate.weights(together, number)
        for key, value in candidate.weights(alone).items():
            close = np.allclose(value, both[key], atol=_CLOSE, rtol=_CLOSE)
            demand(close, f"seed {seed} learns other weights beside another, {key}")
        measured = together.diagnose()
        for key, value in alone.diagnose().items():
            pair, near = (
                (value, measured[key][number]),
                {"atol": _CLOSE, "rtol": _CLOSE},
            )
            close = np.allclose(*pair, **near, equal_nan=True)
            demand(close, f"seed {seed} measures another {key} beside another")


def _measures(candidate: Candidate) -> None:
    learner = candidate.fresh(some_episodes(), (0, 1))
    if candidate.online:
        measured = learner.learn(UPDATES) | learner.diagnose()
        for key, value in measured.items():
            finite = isinstance(value, float) and math.isfinite(value)
            demand(finite, f"{key} is {value!r}, expected a finite number")
        return
    measured = [learner.update() for _ in range(UPDATES)] + [learner.diagnose()]
    for values in measured:
        for key, value in values.items():
            demand(tuple(value.shape) == (2,), f"{key} has shape {tuple(value.shape)}")
            demand(not value.requires_grad, f"{key} carries a graph: detach it")
            demand(value.isfinite().all(), f"{key} is not finite")
    demand(learner.step == UPDATES, f"step is {learner.step} after {UPDATES} updates")
    logged = {key for values in measured for key in values}
    unknown = set(learner.bounds) - logged
    demand(not unknown, f"bounds are of {', '.join(unknown)}, which is not measured")


def _learns(candidate: Candidate) -> None:
    learner = candidate.fresh(some_episodes())
    before = candidate.weights(learner)
    candidate.train(learner)
    after = candidate.weights(learner)
    for name in candidate.agents(learner):
        keys = [key for key in before if key.startswith(f"{name} ")]
        moved = any(not np.array_equal(before[key], after[key]) for key in keys)
        demand(moved, f"the actor {name} stays as it is")


def _acts(candidate: Candidate) -> None:
    for words, arrays in several_layouts(some_episodes()).items():
        learner = candidate.trained(arrays)
        policy = candidate.policy(learner)
        layout = arrays.layout
        for state in arrays.states[:20]:
            action = _first_action(policy, state)
            right = action.shape == (len(layout.action),) and action.dtype == np.float32
            demand(right, f"{words}: an action is {action.dtype} of {action.shape}")
            plan = _plan(policy, state)
            demand_inside(plan, layout, f"{words}: an action is")
        demand_same(_first_action(policy, state), action, f"{words}: actions")
        _sees_its_own(words, policy, state)
        if candidate.online:
            _explores(words, learner.behaviour(), arrays)


def _first_action(policy: LearnedPolicy, state: np.ndarray) -> np.ndarray:
    """Action at the beginning of an episode, always of the same seed."""
    policy.begin(np.random.default_rng(0), policy.layout)
    return policy.act(state)


def _plan(policy: LearnedPolicy, state: np.ndarray) -> np.ndarray:
    """Actions that it plans there, shape (h, k), always of the same seed."""
    policy.begin(np.random.default_rng(0), policy.layout)
    steps = max(agent.actor.form.chunk for agent in policy.agents.values())
    return np.array([policy.act(state) for _ in range(steps)])


def _explores(words: str, policy: Policy, arrays: EpisodeArrays) -> None:
    """The policy that explores keeps to the bounds, here and in another process."""
    layout = arrays.layout
    once, again = policy, pickle.loads(pickle.dumps(policy))
    for each in (once, again):
        each.begin(np.random.default_rng(0), layout)
    for state in arrays.states[:20]:
        action = once.act(state)
        demand_inside(action, layout, f"{words}: it explores")
        demand_same(again.act(state), action, f"{words}: explored actions")


def _sees_its_own(words: str, policy: LearnedPolicy, state: np.ndarray) -> None:
    """An agent's action depends only on the entries that it sees."""
    action, layout = _first_action(policy, state), policy.layout
    layouts = {agent.name: agent for agent in (*layout.agents, layout.joint)}
    for name in policy.agents:
        demand(name in layouts, f"{words}: {name} is none of the agents")
        other = state + 1.0
        seen = list(layouts[name].observation)
        other[seen] = state[seen]
        sets = list(layouts[name].action)
        same = np.array_equal(_first_action(policy, other)[sets], action[sets])
        demand(same, f"{words}: {name} acts on what it does not see")


def _exports(candidate: Candidate) -> None:
    for arrays in several_layouts(some_episodes()).values():
        learner = candidate.trained(arrays)
        policy = candidate.policy(learner)
        states = arrays.states[:20].astype(np.float32)
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch would have another format
            path = Path(folder, "policy.ts")
            metadata = export_policy(policy, path, "torchscript")
            exported = torch.jit.load(path)  # type: ignore[no-untyped-call]
        width = sum(agent.actor.noise for agent in policy.agents.values())
        drawn = np.random.default_rng(0).standard_normal(width, np.float32)
        inputs = [states, np.tile(drawn, (len(states), 1))][: 1 + (width > 0)]
        there = exported(*map(torch.from_numpy, inputs)).numpy()
        here = np.array([_plan(policy, state) for state in states])
        differ = largest_difference(there.reshape(here.shape), here, metadata)
        demand(
            differ <= TOLERANCE,
            f"the export acts otherwise, by {differ:.2g} of half a range",
        )


def _acts_alone(candidate: Candidate) -> None:
    learner = candidate.trained(some_episodes())
    policy = candidate.policy(learner)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "checkpoint.pt")
        candidate.save(path, learner)
        read = load_policy(path)
    demand(read.layout == policy.layout, "the checkpoint has another layout")
    for state in some_episodes().states[:20]:
        here, there = (_first_action(each, state) for each in (policy, read))
        demand_same(there, here, "actions of the checkpoint")


def _odd_values(candidate: Candidate) -> None:
    arrays = some_episodes()
    for name in ("states", "actions", "rewards"):
        values = getattr(arrays, name).copy()
        values[3] = np.nan
        bad: dict[str, Any] = {name: values}
        refused = partial(candidate.fresh, replace(arrays, **bad))
        demand_refused(refused, f"NaN in {name}")


def _streams() -> dict[str, bytes]:
    """States of the global random streams, pickled."""
    return {
        "torch": pickle.dumps(torch.get_rng_state().numpy()),
        "numpy": pickle.dumps(np.random.get_state()),  # noqa: NPY002
        "Python": pickle.dumps(random.getstate()),
    }


def _leaves_alone(candidate: Candidate) -> None:
    arrays, before = some_episodes(), some_episodes()
    torch.manual_seed(7)
    streams = _streams()
    learner = candidate.trained(arrays)
    learner.diagnose()
    for whose, stream in _streams().items():
        what = f"it draws from {whose}'s own stream, not from a batch or its generators"
        demand(stream == streams[whose], what)
    for name in ("states", "actions", "rewards", "terminated", "truncated"):
        demand_same(getattr(arrays, name), getattr(before, name), f"the data's {name}")
    for name, values in before.info.items():
        demand_same(arrays.info[name], values, f"the data's {name}")


def _shown(
    candidate: Candidate, arrays: EpisodeArrays, way: np.ndarray
) -> EpisodeArrays:
    """The episodes with actions, or rewards for actions, that all go the same way."""
    layout, shape = arrays.layout, arrays.actions.shape
    low, high = np.array(layout.low), np.array(layout.high)
    if candidate.online:
        normal = np.random.default_rng(0).uniform(-1.0, 1.0, shape)
        ended = np.ones(arrays.steps, bool)  # so that nothing else is worth anything
        paid = replace(arrays, rewards=PAY * normal @ way, terminated=ended)
    else:
        normal, paid = np.tile(way / 2, (shape[0], 1)), arrays
    actions = low + (normal + 1) / 2 * (high - low)
    return replace(paid, actions=actions.astype(np.float32))


def _own_entries(candidate: Candidate) -> None:
    """The actor sets an entry higher where the data draw it up instead of down."""
    arrays = several_layouts(some_episodes())[UNUSUAL]
    layout = arrays.layout
    place = np.arange(len(layout.action))
    way = np.where(place < len(place) / 2, 1.0, -1.0)  # turned round, it is another
    set_to = []
    for data in (_shown(candidate, arrays, way), _shown(candidate, arrays, -way)):
        updates = SHOWN_ONLINE if candidate.online else SHOWN
        learner = candidate.trained(data, updates=updates)
        policy = candidate.policy(learner)
        policy.begin(np.random.default_rng(0), layout)
        set_to.append(np.mean([policy.act(state) for state in data.states], axis=0))
    for name, rise in zip(
        layout.action_names, (set_to[0] - set_to[1]) * way, strict=True
    ):
        demand(rise > 0, f"{name} does not go the way that data draw it")


_CLAIMS: dict[str, Claim] = {
    "its name and hyper-parameters can be recorded": _names,
    "data and others' random streams are left alone": _leaves_alone,
    "what it learns follows from its seed to the bit": _seeds,
    "it resumes to the bit": _resumes,
    "what it measures is finite, one number a seed": _measures,
    "every agent learns": _learns,
    "each entry of the action learns its own part": _own_entries,
    "actions are within their bounds, for any team": _acts,
    "an exported policy acts as it does": _exports,
    "a checkpoint acts without it": _acts_alone,
}

_OFFLINE_CLAIMS: dict[str, Claim] = {
    "several seeds at once learn what each learns alone": _side_by_side,
    "NaN in data is refused": _odd_values,
}
"""Claims of offline algorithms alone: online ones learn one seed, on finite data."""


def algorithm_claims(candidate: Candidate) -> dict[str, Claim]:
    """Claims about an algorithm, by their texts."""
    return _CLAIMS | ({} if candidate.online else _OFFLINE_CLAIMS)
