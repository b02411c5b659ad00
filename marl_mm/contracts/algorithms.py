"""What every algorithm keeps to, offline and online."""

import json
import math
import pickle
import random
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import read_checkpoint, save_checkpoint, save_seed
from marl_mm.algorithms.export import TOLERANCE, export_policy
from marl_mm.algorithms.online import OnlineAlgorithm
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm
from marl_mm.algorithms.speed import prepare_for_small_networks
from marl_mm.contracts.claims import Claim, demand, demand_refused, demand_same
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.layout import Agent, Layout
from marl_mm.policy import Policy

UPDATES = 7
"""Updates between the points that claims compare: of no rhythm that may be lost."""

SHOWN, SHOWN_ONLINE = 20, 100
"""Updates after which it shows which way data draw an action."""

PAY = 4.0
"""What an entry of the action at its bound is paid, to see whether that is learnt."""

_CLOSE = 1e-5
"""Largest difference of weights that learnt alone and beside others."""


@dataclass(frozen=True)
class Named:
    """An algorithm and its name."""

    name: str
    algorithm: Algorithm

    @property
    def config(self) -> Any:
        """Small hyper-parameters: quick where they have the usual names."""
        config = self.algorithm.presets[TUNED]
        small = {
            "hidden": (16,),
            "batch_size": 16,
            "precision": "highest",
            "warm_up": 8,
            "capacity": 2_000,
        }
        known = {one.name for one in fields(config)}
        return replace(config, **{k: v for k, v in small.items() if k in known})


def named(name: str) -> Named:
    """A registered algorithm."""
    return Named(name, ALGORITHMS.get(name))


OTHERWISE = "three agents whose entries are in another order"
"""Words for a team that is as unlike the usual one as can be."""


def several_layouts(arrays: EpisodeArrays) -> dict[str, EpisodeArrays]:
    """The same episodes as seen by other teams, with entries in another order."""
    usual = arrays.layout
    order = [*range(len(usual.state))][::-1]
    names = usual.state_names
    three = Layout(
        tuple(usual.state[i] for i in order),
        usual.action,
        (
            Agent("last", names[:3], usual.action_names[3:]),
            Agent("middle", names[2:9], usual.action_names[1:3][::-1]),
            Agent("first", (names[9], names[0]), usual.action_names[:1]),
        ),
        usual.compared,
        usual.desired,
    )
    alone = replace(usual, team=(Agent("all", names, usual.action_names),))
    return {
        "two agents": arrays,
        OTHERWISE: replace(arrays, states=arrays.states[:, order], layout=three),
        "one agent": replace(arrays, layout=alone),
    }


def _data() -> EpisodeArrays:
    return shipped_arrays().select(range(16))


def _fresh(one: Named, arrays: EpisodeArrays, seeds: tuple[int, ...] = (0,)) -> Any:
    """A learner; an online one has seen the episodes."""
    prepare_for_small_networks()
    task, learner = make_task(), one.algorithm.learner
    if not one.algorithm.online:
        return learner(one.config, arrays, task, seeds, "cpu")
    made = learner(one.config, task, seeds[0], (), arrays.layout)
    for number in range(len(arrays)):
        made.observe(arrays.episode(number))
    return made


def _go_on(one: Named, made: Any, updates: int = UPDATES) -> None:
    if one.algorithm.online:
        made.learn(updates)
    else:
        for _ in range(updates):
            made.update()


def _agents(one: Named, made: Any, number: int = 0) -> Any:
    return made.agents if one.algorithm.online else made.agents(number)


def _policy(one: Named, made: Any) -> LearnedPolicy:
    return LearnedPolicy(one.name, _agents(one, made), made.layout)


def _weights(one: Named, made: Any, number: int = 0) -> dict[str, np.ndarray]:
    return {
        f"{name} {key}": value.detach().numpy().copy()
        for name, agent in _agents(one, made, number).items()
        for key, value in agent.actor.state_dict().items()
    }


def _flat(state: Any, path: str = "state") -> dict[str, Any]:
    """Tensors and numbers of a nested state by their paths."""
    if isinstance(state, Mapping):
        parts = {f"{path}.{key}": value for key, value in state.items()}
    elif isinstance(state, list | tuple):
        parts = {f"{path}.{i}": value for i, value in enumerate(state)}
    else:
        return {path: state}
    return {key: v for p, one in parts.items() for key, v in _flat(one, p).items()}


def _same_state(one: Any, other: Any) -> None:
    here, there = _flat(one), _flat(other)
    demand(here.keys() == there.keys(), "states have other keys")
    for key, value in here.items():
        if isinstance(value, torch.Tensor):
            demand_same(value.cpu().numpy(), there[key].cpu().numpy(), key)
        else:
            demand(value == there[key], f"{key} is {value}, then {there[key]}")


def _state(one: Named, made: Any) -> Any:
    return made.state() if one.algorithm.online else made.state(0)


def _save(one: Named, path: Path, made: Any) -> None:
    if one.algorithm.online:
        save_checkpoint(path, made)
    else:
        save_seed(path, made, 0)


def _names(one: Named) -> None:
    for preset, config in one.algorithm.presets.items():
        how = getattr(config, "__dataclass_params__", None)
        demand(
            how is not None and how.frozen, f"preset {preset} is no frozen dataclass"
        )
        json.dumps(asdict(config))
    made = _fresh(one, _data())
    missing = _members(OnlineAlgorithm if one.algorithm.online else OfflineAlgorithm)
    missing = {name for name in missing if not hasattr(made, name)}
    demand(not missing, f"the learner has no {', '.join(sorted(missing))}")
    demand(made.name == one.name, f"the learner calls itself {made.name!r}")


def _members(protocol: type) -> set[str]:
    """Names of a protocol's public members, inherited ones included."""
    parts = (one for one in protocol.__mro__ if getattr(one, "_is_protocol", False))
    names = {name for one in parts for name in {*vars(one), *one.__annotations__}}
    return {name for name in names if not name.startswith("_")}


def _seeds(one: Named) -> None:
    torch.manual_seed(1)
    first = _fresh(one, _data())
    _go_on(one, first)
    torch.manual_seed(2)
    again, other = _fresh(one, _data()), _fresh(one, _data(), (1,))
    for made in (again, other):
        _go_on(one, made)
    _same_state(_state(one, first), _state(one, again))
    here, there = _weights(one, first), _weights(one, other)
    differ = any(not np.array_equal(here[key], there[key]) for key in here)
    demand(differ, "two seeds learn the same")


def _resumes(one: Named) -> None:
    straight = _fresh(one, _data())
    _go_on(one, straight)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "checkpoint.pt")
        _save(one, path, straight)
        _go_on(one, straight)
        state = read_checkpoint(path, one.name)["state"]
    resumed = _fresh(one, _data())
    if one.algorithm.online:
        resumed.load_state(state)
    else:
        resumed.load_states([state])
        demand(resumed.step == UPDATES, f"it resumes at update {resumed.step}")
    _go_on(one, resumed)
    for count in ("episodes", "env_steps", "updates") if one.algorithm.online else ():
        here, there = getattr(straight, count), getattr(resumed, count)
        demand(here == there, f"{count} are {here}, resumed {there}")
    _same_state(_state(one, straight), _state(one, resumed))


def _side_by_side(one: Named) -> None:
    together = _fresh(one, _data(), (3, 5))
    _go_on(one, together)
    for number, seed in enumerate((3, 5)):
        alone = _fresh(one, _data(), (seed,))
        _go_on(one, alone)
        both = _weights(one, together, number)
        for key, value in _weights(one, alone).items():
            close = np.allclose(value, both[key], atol=_CLOSE, rtol=_CLOSE)
            demand(close, f"seed {seed} learns other weights beside another, {key}")


def _measures(one: Named) -> None:
    made = _fresh(one, _data(), (0, 1))
    if one.algorithm.online:
        measured = made.learn(UPDATES) | made.diagnose()
        for key, value in measured.items():
            finite = isinstance(value, float) and math.isfinite(value)
            demand(finite, f"{key} is {value!r}, expected a finite number")
        return
    measured = [made.update() for _ in range(UPDATES)] + [made.diagnose()]
    for values in measured:
        for key, value in values.items():
            demand(tuple(value.shape) == (2,), f"{key} has shape {tuple(value.shape)}")
            demand(not value.requires_grad, f"{key} carries a graph: detach it")
            demand(value.isfinite().all(), f"{key} is not finite")
    demand(made.step == UPDATES, f"step is {made.step} after {UPDATES} updates")
    told = {key for values in measured for key in values}
    unknown = set(made.bounds) - told
    demand(not unknown, f"bounds are of {', '.join(unknown)}, which is not measured")


def _learns(one: Named) -> None:
    made = _fresh(one, _data())
    before = _weights(one, made)
    _go_on(one, made)
    after = _weights(one, made)
    for name in _agents(one, made):
        own = [key for key in before if key.startswith(f"{name} ")]
        moved = any(not np.array_equal(before[key], after[key]) for key in own)
        demand(moved, f"the actor {name} stays as it is")


def _acts(one: Named) -> None:
    for words, arrays in several_layouts(_data()).items():
        made = _fresh(one, arrays)
        _go_on(one, made)
        policy = _policy(one, made)
        layout = arrays.layout
        policy.begin(np.random.default_rng(0), layout)
        for state in arrays.states[:20]:
            action = policy.act(state)
            right = action.shape == (len(layout.action),) and action.dtype == np.float32
            demand(right, f"{words}: an action is {action.dtype} of {action.shape}")
            inside = (action >= layout.low).all() and (action <= layout.high).all()
            demand(inside, f"{words}: an action is outside of the action space")
        demand_same(policy.act(state), policy.act(state), f"{words}: actions")
        _sees_its_own(words, policy, state)
        if one.algorithm.online:
            _explores(words, made.behaviour(), arrays)


def _explores(words: str, policy: Policy, arrays: EpisodeArrays) -> None:
    """Who runs its episodes keeps to the bounds, here and in another process."""
    layout = arrays.layout
    once, again = policy, pickle.loads(pickle.dumps(policy))
    for each in (once, again):
        each.begin(np.random.default_rng(0), layout)
    for state in arrays.states[:20]:
        action = once.act(state)
        inside = (action >= layout.low).all() and (action <= layout.high).all()
        demand(inside, f"{words}: it explores outside of the action space")
        demand_same(again.act(state), action, f"{words}: explored actions")


def _sees_its_own(words: str, policy: LearnedPolicy, state: np.ndarray) -> None:
    """What an agent does not see does not change what it does."""
    action, layout = policy.act(state), policy.layout
    known = {agent.name: agent for agent in (*layout.agents, layout.joint)}
    for name in policy.agents:
        demand(name in known, f"{words}: {name} is none of the agents")
        other = state + 1.0
        own = list(known[name].observation)
        other[own] = state[own]
        sets = list(known[name].action)
        same = np.array_equal(policy.act(other)[sets], action[sets])
        demand(same, f"{words}: {name} acts on what it does not see")


def _exports(one: Named) -> None:
    for arrays in several_layouts(_data()).values():
        made = _fresh(one, arrays)
        _go_on(one, made)
        policy, states = _policy(one, made), arrays.states[:20].astype(np.float32)
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch would have another format
            path = Path(folder, "policy.ts")
            export_policy(policy, path, "torchscript")
            exported = torch.jit.load(path)  # type: ignore[no-untyped-call]
        there = exported(torch.from_numpy(states)).numpy()
        differ = np.abs(there - [policy.act(state) for state in states]).max()
        demand(differ <= TOLERANCE, f"the export acts otherwise, by {differ:.2g}")


def _acts_alone(one: Named) -> None:
    made = _fresh(one, _data())
    _go_on(one, made)
    own = _policy(one, made)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "checkpoint.pt")
        _save(one, path, made)
        read = load_policy(path)
    demand(read.layout == own.layout, "the checkpoint has another layout")
    for state in _data().states[:20]:
        demand_same(read.act(state), own.act(state), "actions of the checkpoint")


def _odd_values(one: Named) -> None:
    arrays = _data()
    for name in ("states", "actions", "rewards"):
        values = getattr(arrays, name).copy()
        values[3] = np.nan
        bad: dict[str, Any] = {name: values}
        demand_refused(partial(_fresh, one, replace(arrays, **bad)), f"NaN in {name}")


def _streams() -> dict[str, bytes]:
    """Where the random streams that belong to nobody stand."""
    return {
        "torch": pickle.dumps(torch.get_rng_state().numpy()),
        "numpy": pickle.dumps(np.random.get_state()),  # noqa: NPY002
        "Python": pickle.dumps(random.getstate()),
    }


def _leaves_alone(one: Named) -> None:
    arrays, before = _data(), _data()
    torch.manual_seed(7)
    streams = _streams()
    made = _fresh(one, arrays)
    _go_on(one, made)
    made.diagnose()
    for whose, stream in _streams().items():
        demand(stream == streams[whose], f"it draws from {whose}'s own stream")
    for name in ("states", "actions", "rewards", "terminated", "truncated"):
        demand_same(getattr(arrays, name), getattr(before, name), f"the data's {name}")
    for name, values in before.info.items():
        demand_same(arrays.info[name], values, f"the data's {name}")


def _shown(one: Named, arrays: EpisodeArrays, way: np.ndarray) -> EpisodeArrays:
    """The same states with actions, or rewards for actions, that go one way."""
    layout, shape = arrays.layout, arrays.actions.shape
    low, high = np.array(layout.low), np.array(layout.high)
    if one.algorithm.online:
        normal = np.random.default_rng(0).uniform(-1.0, 1.0, shape)
        ended = np.ones(arrays.steps, bool)  # so that nothing else is worth anything
        paid = replace(arrays, rewards=PAY * normal @ way, terminated=ended)
    else:
        normal, paid = np.tile(way / 2, (shape[0], 1)), arrays
    actions = low + (normal + 1) / 2 * (high - low)
    return replace(paid, actions=actions.astype(np.float32))


def _own_entries(one: Named) -> None:
    """Where data draw an entry up instead of down, the actor sets it higher."""
    arrays = several_layouts(_data())[OTHERWISE]
    layout = arrays.layout
    place = np.arange(len(layout.action))
    way = np.where(place < len(place) / 2, 1.0, -1.0)  # turned round, it is another
    set_to = []
    for data in (_shown(one, arrays, way), _shown(one, arrays, -way)):
        made = _fresh(one, data)
        _go_on(one, made, SHOWN_ONLINE if one.algorithm.online else SHOWN)
        policy = _policy(one, made)
        set_to.append(np.mean([policy.act(state) for state in data.states], axis=0))
    for name, rise in zip(
        layout.action_names, (set_to[0] - set_to[1]) * way, strict=True
    ):
        demand(rise > 0, f"{name} does not go the way that data draw it")


_CLAIMS: dict[str, Claim] = {
    "its name and hyper-parameters can be recorded": _names,
    "what it learns follows from its seed to the bit": _seeds,
    "it resumes to the bit": _resumes,
    "what it measures is finite, one number a seed": _measures,
    "every agent learns": _learns,
    "each entry of the action learns its own part": _own_entries,
    "actions are within their bounds, for any team": _acts,
    "an exported policy acts as it does": _exports,
    "a checkpoint acts without it": _acts_alone,
    "data and others' random streams are left alone": _leaves_alone,
}

_OFFLINE_CLAIMS: dict[str, Claim] = {
    "several seeds at once learn what each learns alone": _side_by_side,
    "NaN in data is refused": _odd_values,
}
"""Online, seeds follow one another, and environments keep data finite."""


def algorithm_claims(one: Named) -> dict[str, Claim]:
    """Claims about an algorithm, by their words."""
    return _CLAIMS | ({} if one.algorithm.online else _OFFLINE_CLAIMS)
