"""What the package promises holds of its own, and each claim finds its mistakes.

Every planted mistake breaks the claims that are named with it, for the reason that is
named, and no other claim: none is found by chance.
"""

import json
import math
import os
import random
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import nn

from marl_mm import plugins
from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.maddpg import Maddpg
from marl_mm.algorithms.matd3_bc import Matd3Bc
from marl_mm.algorithms.networks import Actor
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED
from marl_mm.algorithms.replay import Batch
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.cli import main
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.contracts import algorithms, collectors, learners, metrics, tasks
from marl_mm.contracts.claims import Claim, Finding, examine
from marl_mm.contracts.episodes import episodes, short
from marl_mm.envs.cruise import ALPHA
from marl_mm.envs.order import Order
from marl_mm.envs.registry import TASKS, kind_of, register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Task, Terms, Values
from marl_mm.envs.tasks.carry import Carry
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import Episode
from marl_mm.eval.metrics import Metric
from marl_mm.layout import AgentLayout, Layout
from marl_mm.policy import Policy
from marl_mm.registry import BUILT_IN, Registry

ROOT = Path(__file__).resolve().parents[2]
PLUGINS = sorted((ROOT / "examples" / "plugins").glob("*.py"))

Output = pytest.CaptureFixture[str]
Broken = dict[str, str]
"""Claims that do not hold, and a part of why."""


pytestmark = pytest.mark.usefixtures("registries")


def built_in(kind: Registry[Any]) -> list[str]:
    return [name for name in kind.names() if kind.origin(name) == BUILT_IN]


def broken(findings: Iterable[Finding]) -> Broken:
    return {finding.claim: finding.broken for finding in findings if finding.broken}


def of_task(name: str) -> Broken:
    about = short(name)
    return broken(examine(name, about, tasks.task_claims(about)))


def of_algorithm(about: learners.Candidate, but: Sequence[str] = ()) -> Broken:
    claims = algorithms.algorithm_claims(about)
    return broken(examine(about.name, about, without(claims, but)))


def of_collector(about: collectors.Candidate, but: Sequence[str] = ()) -> Broken:
    claims = collectors.collector_claims(about)
    return broken(examine(about.name, about, without(claims, but)))


def without(claims: Mapping[str, Claim], words: Sequence[str]) -> dict[str, Claim]:
    assert claims.keys() >= set(words)
    return {text: claim for text, claim in claims.items() if text not in words}


def expect(found: Broken, expected: Mapping[str, str]) -> None:
    """These claims are broken, for these reasons, and all others hold."""
    assert found.keys() == expected.keys(), found
    for claim, why in expected.items():
        assert why in found[claim], found[claim]


# --- What there is -----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name for name in built_in(TASKS) if kind_of(name) == name]
)
def test_built_in_tasks_keep_their_claims(name: str) -> None:
    assert of_task(name) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", built_in(ALGORITHMS))
def test_built_in_algorithms_keep_their_claims(name: str) -> None:
    assert of_algorithm(learners.candidate(name)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", built_in(COLLECTORS))
def test_built_in_collectors_keep_their_claims(name: str) -> None:
    assert of_collector(collectors.candidate(name)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("path", PLUGINS, ids=lambda path: path.stem)
def test_plug_ins_of_the_examples_keep_their_claims(path: Path) -> None:
    origin = plugins.load(path).name
    kinds: tuple[tuple[Registry[Any], Callable[[str], Broken]], ...] = (
        (TASKS, of_task),
        (ALGORITHMS, lambda name: of_algorithm(learners.candidate(name))),
        (COLLECTORS, lambda name: of_collector(collectors.candidate(name))),
    )
    found = {
        name: check(name)
        for kind, check in kinds
        for name in kind.names()
        if kind.origin(name) == origin
    }
    assert found
    assert not any(found.values()), found


# --- Mistakes of tasks -------------------------------------------------------

LAYOUT = "its layout is complete, and states are within it"
SEEDS = "episodes follow from their seeds to the bit"
BESIDE = "an episode keeps nothing on the task"
NUMBERS = "its step numbers are finite"
HIGHEST = "no return passes its highest"
ENDS = "episodes end once, and in time"
HINDSIGHT = "rewards in hindsight are those online to the bit"
REPLAYS = "a dataset of it passes verify, and replays to the bit"
GOALS = "goals of evaluations are its own"
ACTIONS = "actions at their bounds work, and those that make no sense are refused"
EXPERT = "its expert, if any, sets every entry within bounds, by the state alone"
TRAVELS = "it travels to workers and into records"
PETTINGZOO = "PettingZoo's own tests pass"
GYMNASIUM = "Gymnasium's own test passes"

RUN = (SEEDS, BESIDE, NUMBERS, HIGHEST, ENDS, HINDSIGHT, REPLAYS, EXPERT)
"""Claims that look at whole episodes."""


class GlobalStream(Reach):
    """Goals come from numpy's stream that belongs to nobody."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        drawn = np.random.uniform([1.0, -0.2, 0.55], [1.5, 0.2, 0.8])  # noqa: NPY002
        super().begin(attempt, rng, drawn if goal is None else goal)


class WallClock(Reach):
    """The reward depends on when it is asked for."""

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        usual = super().reward(achieved, desired, terms)
        return usual - 1e-9 * time.perf_counter_ns()


class Remembers(Reach):
    """Alpha in the first state is what it was at the end of the episode before."""

    last: ClassVar[list[float]] = [0.0]

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        self.last[0] = action[ALPHA.name]
        return super().act(attempt, action)

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        super().begin(attempt, rng, goal)
        attempt.memory.alpha = self.last[0]


class KeepsOnTask(Reach):
    """What was seen last is kept where any episode keeps it."""

    hand: ClassVar[list[float]] = [0.0]

    def observe(self, attempt: Attempt) -> Values:
        seen = super().observe(attempt)
        self.hand[0] = abs(seen["end_effector_y"])
        return seen

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        return super().act(attempt, {**action, ALPHA.name: min(self.hand[0], 1.0)})


class OneStart(Reach):
    """Whatever the seed is, it begins in the same way."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        super().begin(attempt, np.random.default_rng(0), goal)


class Forgets(Reach):
    """An entry of the state is not told."""

    def observe(self, attempt: Attempt) -> Values:
        seen = dict(super().observe(attempt))
        del seen["base_yaw"]
        return seen


class TellsMore(Reach):
    """An entry is told that the layout has not."""

    def observe(self, attempt: Attempt) -> Values:
        return {**super().observe(attempt), "speed": 1.0}


class OutOfBounds(Reach):
    """From the third step on, alpha is told in percent."""

    def observe(self, attempt: Attempt) -> Values:
        seen = super().observe(attempt)
        return {**seen, "control_mode": 50.0} if attempt.steps > 2 else seen


class TellsNan(Reach):
    """From the third step on, an entry is no number."""

    def observe(self, attempt: Attempt) -> Values:
        seen = super().observe(attempt)
        return {**seen, "base_y": np.nan} if attempt.steps > 2 else seen


class TellsInfinity(Reach):
    """An entry without bounds is infinite."""

    def observe(self, attempt: Attempt) -> Values:
        return {**super().observe(attempt), "base_y": np.inf}


class PaysProgress(Reach):
    """The reward compares with what it was asked for before."""

    last: ClassVar[list[np.ndarray]] = [np.zeros(())]

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        now = self.distance(achieved, desired)
        before, self.last[0] = self.last[0], now.mean()
        return np.asarray(before - now)


class PaysInComparison(Reach):
    """The reward of one step depends on the others that are judged with it."""

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        usual = super().reward(achieved, desired, terms)
        return np.asarray(usual - terms["d_mm"] / np.mean(terms["d_mm"]))


class OneByOne(Reach):
    """The reward can only be asked for one step."""

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        x, y, z = (achieved - desired).tolist()
        return np.asarray(-((x * x + y * y + z * z) ** 0.5))


class PaysDistance(Reach):
    """It is better to be far from the goal."""

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        return np.asarray(np.minimum(self.distance(achieved, desired), 5.0) - 5.0)


class NeverEnds(Reach):
    """In hindsight no goal was reached."""

    def judge(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> tuple[np.ndarray, np.ndarray]:
        reward, ended = super().judge(achieved, desired, terms)
        return reward, np.zeros_like(ended)


class GoalMovesRobot(Reach):
    """What is not the goal depends on it, so that hindsight is none."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        super().begin(attempt, rng, goal)
        attempt.memory.alpha = float(abs(attempt.goal[1]))


class LowBound(Reach):
    """A hit is worth more than the highest return."""

    highest_return = 5.0


class PaysEachStep(Reach):
    """Only a step's own reward is below the highest return."""

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        return np.full(np.shape(terms["d_mm"]), 4.0)


class NeedsNothing(Reach):
    """Rewards depend on what nothing tells."""

    needs = (*Reach.needs, "temper")


class FailsWithoutWords(Carry):
    """A failure is no word but a truth."""

    def failure(self, attempt: Attempt) -> str:
        return attempt.steps == 3  # type: ignore[return-value]


class Endless(Reach):
    """Its steps begin anew."""

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        attempt.steps = 0
        return super().act(attempt, action)


class Divides(Reach):
    """One of the actions that it allows is too much for it."""

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        half = 0.5 / action[ALPHA.name]
        return super().act(attempt, {**action, ALPHA.name: min(half, 1.0)})


class ExpertForgets(Reach):
    """The expert does not set alpha."""

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        action = dict(super().expert(state, script))
        del action[ALPHA.name]
        return action


class ExpertExceeds(Reach):
    """The expert wants more than there is, in some states."""

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        more = 0.5 if state["control_mode"] == self.initial_alpha else 1.5
        return {**super().expert(state, script), ALPHA.name: more}


class ExpertRemembers(Reach):
    """The expert alternates."""

    asked: ClassVar[list[int]] = []

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        self.asked.append(1)
        return {**super().expert(state, script), ALPHA.name: len(self.asked) % 2}


class GoalsByCount(Reach):
    """Goals of evaluations depend on those that were asked for before."""

    asked: ClassVar[list[int]] = []

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        self.asked.append(index)
        return 1.0 + len(self.asked) / 100, 0.0, 0.7


class GoalsTooWide(Reach):
    """A goal of an evaluation has an entry too many."""

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        return 1.0, 0.0, 0.7, 0.0


class OwnGoals(Reach):
    """Goals are drawn, also where one is given; evaluations have none of their own."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        super().begin(attempt, rng, None)

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        return None


@dataclass(frozen=True, kw_only=True)
class Unpicklable(Reach):
    """One of its numbers is a function."""

    scale: Any = lambda x: x


@dataclass(frozen=True, kw_only=True)
class NotJson(Reach):
    """One of its numbers is a set."""

    entries: frozenset[str] = frozenset({"goal_x"})


@dataclass(frozen=True, kw_only=True)
class OtherInJson(Reach):
    """The keys of one of its numbers are words when they are read again."""

    table: dict[int, float] = field(default_factory=lambda: {1: 2.0})


class MoodyInfo(Reach):
    """A step number is a word."""

    own_info: ClassVar[dict[str, str]] = {**Reach.own_info, "mood": "of the robot"}

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        return {**super().measure(attempt), "mood": "good"}


class SilentInfo(Reach):
    """A step number is promised and not told."""

    own_info: ClassVar[dict[str, str]] = {**Reach.own_info, "mood": "of the robot"}


LEFT_OUT = "LayoutError: Forgets.observe returns no 'base_yaw'"
NOT_TOLD = "LayoutError: SilentInfo.measure: mood, which own_info has, is None"
MOODY = "LayoutError: MoodyInfo.measure: mood, which own_info has, is 'good'"
WORDLESS = "LayoutError: FailsWithoutWords.failure is False, expected words"
ENDLESS = "an episode goes on after 5 steps"
NO_NAME = "NeedsNothing.needs has temper, which neither"

TASKS_MISTAKEN: list[tuple[Reach, Broken]] = [
    (
        GlobalStream(),
        {
            SEEDS: "states differ at [0, 7]",
            BESIDE: "states beside another episode differ at [7]",
            REPLAYS: "states differ: at [0, 7]",
            PETTINGZOO: "Incorrect observations",
            GYMNASIUM: "the observations are not equivalent",
        },
    ),
    (
        WallClock(),
        {
            SEEDS: "rewards differ at [0]",
            BESIDE: "rewards differ",
            HINDSIGHT: "rewards differ at [0]",
            REPLAYS: "rewards differ: at [0]",
            PETTINGZOO: "Incorrect values for rewards",
            GYMNASIUM: "step rewards are not equivalent",
        },
    ),
    (
        Remembers(),
        {
            SEEDS: "states differ at [0, 6]",
            BESIDE: "states beside another episode differ at [6]",
            HINDSIGHT: "states with another goal differ at [0, 6]",
            REPLAYS: "states differ: at [0, 6]",
        },
    ),
    (
        KeepsOnTask(),
        {
            BESIDE: "states beside another episode differ at [0]",
            PETTINGZOO: "Incorrect observations",
        },
    ),
    (OneStart(), {SEEDS: "all seeds begin in the same state"}),
    (
        Forgets(),
        dict.fromkeys((*RUN, LAYOUT, GOALS, ACTIONS, PETTINGZOO, GYMNASIUM), LEFT_OUT),
    ),
    (TellsMore(), {LAYOUT: "observe tells speed, not in it"}),
    (
        OutOfBounds(),
        {
            LAYOUT: "control_mode [1] in [0, 1] is 50",
            REPLAYS: "9 states outside of their entries' bounds",
        },
    ),
    (
        TellsNan(),
        dict.fromkeys(
            (*RUN, LAYOUT, PETTINGZOO), "TellsNan.observe: base_y [m] is nan"
        ),
    ),
    (
        TellsInfinity(),
        dict.fromkeys(
            (*RUN, LAYOUT, GOALS, ACTIONS, PETTINGZOO, GYMNASIUM),
            "TellsInfinity.observe: base_y [m] is inf",
        ),
    ),
    (
        PaysProgress(),
        {
            SEEDS: "rewards differ at [0]",
            BESIDE: "rewards differ",
            HINDSIGHT: "rewards differ at [1]",
            REPLAYS: "rewards differ: at [0]",
            PETTINGZOO: "Incorrect values for rewards",
            GYMNASIUM: "step rewards are not equivalent",
        },
    ),
    (PaysInComparison(), {HINDSIGHT: "rewards differ at [0]"}),
    (OneByOne(), dict.fromkeys((HIGHEST, HINDSIGHT), "too many values to unpack")),
    (PaysDistance(), {HINDSIGHT: "a goal that was hit is worth less"}),
    (NeverEnds(), {HINDSIGHT: "ends at a goal that it came to differ"}),
    (GoalMovesRobot(), {HINDSIGHT: "states with another goal differ at [0, 6]"}),
    (LowBound(), {HIGHEST: "a hit's reward is 9.6"}),
    (PaysEachStep(), {HIGHEST: "a return is 20, the bound 10"}),
    (
        NeedsNothing(),
        dict.fromkeys((*RUN, LAYOUT, ACTIONS, PETTINGZOO, GYMNASIUM), NO_NAME)
        | {NUMBERS: "needs temper, which nothing tells"},
    ),
    (
        FailsWithoutWords(),
        dict.fromkeys((*RUN, LAYOUT, ACTIONS, PETTINGZOO, GYMNASIUM), WORDLESS),
    ),
    (Endless(), dict.fromkeys((*RUN, LAYOUT), ENDLESS)),
    (Divides(), {ACTIONS: "ZeroDivisionError"}),
    (ExpertForgets(), {EXPERT: "the expert sets delta_x, delta_y, delta_z: alpha"}),
    (ExpertExceeds(), {EXPERT: "the expert sets alpha [1] in [0, 1] to 1.5"}),
    (ExpertRemembers(), {EXPERT: "acts otherwise in the same state"}),
    (GoalsByCount(), {GOALS: "depend on how many there are"}),
    (GoalsTooWide(), {GOALS: "expected 3 finite numbers: goal_x"}),
    (
        OwnGoals(),
        {
            GOALS: "given goals differ at [0]",
            HINDSIGHT: "rewards for a goal that it came to differ",
        },
    ),
    (Unpicklable(), {TRAVELS: "PicklingError"}),
    (NotJson(), {TRAVELS: "frozenset is not JSON serializable"}),
    (OtherInJson(), {TRAVELS: "another one when made of its numbers"}),
    (
        MoodyInfo(),
        dict.fromkeys((*RUN, LAYOUT, ACTIONS, PETTINGZOO, GYMNASIUM), MOODY),
    ),
    (
        SilentInfo(),
        dict.fromkeys((*RUN, LAYOUT, ACTIONS, PETTINGZOO, GYMNASIUM), NOT_TOLD),
    ),
]


def called(value: object) -> str:
    return "" if isinstance(value, dict) else type(value).__name__


@pytest.mark.slow
@pytest.mark.parametrize(("task", "expected"), TASKS_MISTAKEN, ids=called)
def test_a_tasks_mistake_breaks_its_claims(task: Reach, expected: Broken) -> None:
    name = f"planted-{called(task)}-v0"
    register_task(name, task)
    expect(of_task(name), expected)


# --- Mistakes of algorithms --------------------------------------------------

NAMES = "its name and hyper-parameters can be recorded"
SEED = "what it learns follows from its seed to the bit"
RESUMES = "it resumes to the bit"
MEASURES = "what it measures is finite, one number a seed"
LEARNS = "every agent learns"
OWN = "each entry of the action learns its own part"
ACTS = "actions are within their bounds, for any team"
EXPORTS = "an exported policy acts as it does"
CHECKPOINT = "a checkpoint acts without it"
ALONE = "data and others' random streams are left alone"
TOGETHER = "several seeds at once learn what each learns alone"
ODD = "NaN in data is refused"

Tensors = dict[str, torch.Tensor]
Agents = dict[str, AgentActor]
State = Mapping[str, Any]


class Misnamed(Mabc):
    """It calls itself by another name than it is registered by."""


class GlobalWeights(Mabc):
    """Weights are shaken by torch's stream that belongs to nobody."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        with torch.no_grad():
            for network in self.actors.networks.values():
                network.flat.add_(1e-3 * torch.randn(network.flat.shape))


class OneSeed(Mabc):
    """All seeds are seed 0."""

    def __init__(
        self, config: Any, arrays: Any, judge: Any, seeds: Sequence[int], device: str
    ) -> None:
        super().__init__(config, arrays, judge, [0] * len(seeds), device)
        self.seeds = tuple(seeds)


class SharedStream(Mabc):
    """All seeds draw the first one's batches."""

    def __init__(
        self, config: Any, arrays: Any, judge: Any, seeds: Sequence[int], device: str
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device)
        rest = (config.future, 0.0), judge, [seeds[0]] * len(seeds), device
        self._batches = OfflineBatches(arrays, config.batch_size, *rest)


class ForgetsOptimiser(Mabc):
    """Adam begins anew when it resumes."""

    def load_states(self, states: Sequence[State]) -> None:
        self.step = states[0]["step"]
        for number, state in enumerate(states):
            self.actors.load_state(number, state["actors"])
        self._batches.load_states([state["batches"] for state in states])


class ForgetsTargets(Td3Bc):
    """Checkpoints lack the targets."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        parts = self._parts.items()
        self._parts = {name: p for name, p in parts if not name.startswith("target")}


class ForgetsStep(Mabc):
    """It counts from 0 when it resumes."""

    def load_states(self, states: Sequence[State]) -> None:
        super().load_states(states)
        self.step = 0


class ForgetsBatches(Mabc):
    """The same batches come again when it resumes."""

    def load_states(self, states: Sequence[State]) -> None:
        before = [self._batches.state(number) for number in range(len(states))]
        super().load_states(states)
        self._batches.load_states(before)


class ForgetsRhythm(Mabc):
    """It learns less in every second update, which it counts for itself."""

    turn = False

    def update(self) -> Tensors:
        losses = super().update()
        self.turn = not self.turn
        with torch.no_grad():
            for network in self.actors.networks.values():
                network.flat.mul_(0.999 if self.turn else 1.0)
        return losses


class MeasuresGraph(Mabc):
    """A measured number carries its graph."""

    def update(self) -> Tensors:
        losses = super().update()
        weights = self.actors.networks[self.layouts[0].name].weights["0.weight"]
        return losses | {"size": weights.square().sum(dim=(1, 2))}


class MeasuresNan(Mabc):
    """A measured number is none."""

    def diagnose(self) -> Tensors:
        return super().diagnose() | {"size": torch.full((len(self.seeds),), np.nan)}


class MeasuresMean(Mabc):
    """A measured number is of all seeds."""

    def update(self) -> Tensors:
        return {name: loss.mean() for name, loss in super().update().items()}


class BoundsNothing(Mabc):
    """Training is to stop by a number that is not measured."""

    @property
    def bounds(self) -> dict[str, float]:
        return {"q/largest": 1.0}


class NeverLearns(Mabc):
    """Its updates are undone."""

    idle: ClassVar[slice] = slice(None)

    def update(self) -> Tensors:
        networks = [*self.actors.networks.values()][self.idle]
        before = [network.flat.detach().clone() for network in networks]
        losses = super().update()
        with torch.no_grad():
            for network, flat in zip(networks, before, strict=True):
                network.flat.copy_(flat)
        return losses


class OneLearns(NeverLearns):
    """The updates of all agents but the first are undone."""

    idle = slice(1, None)


class InTurn(Mabc):
    """Agents are taken to set the action's entries one after the other."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        order = [place for agent in self.layouts for place in agent.action]
        draw, back = self._batches.next, torch.tensor(order).argsort()
        self._batches.next = lambda: (  # type: ignore[method-assign]
            (batch := draw())._replace(action=batch.action[..., back])
        )


class InTurnOnline(Maddpg):
    """The actors' actions are joined one after the other."""

    def _actor_loss(self, batch: Batch) -> torch.Tensor:
        state = batch.observation
        parts = [agent.actor(agent.observed(state)) for agent in self.agents.values()]
        loss: torch.Tensor = -self.critic(state, torch.cat(parts, dim=-1)).mean()
        return loss


class Doubled(AgentActor):
    """An actor that acts twice as much as it should."""

    def plan(self, observation: np.ndarray, noise: Any = None) -> np.ndarray:
        return 2 * super().plan(observation, noise) + 1.0


class ActsTooMuch(Mabc):
    """Actions are beyond their bounds."""

    def agents(self, number: int) -> Agents:
        found = super().agents(number).items()
        return {name: Doubled(agent.layout, agent.actor) for name, agent in found}


class SeesAll(Matd3Bc):
    """Each agent sees the joint state, whatever its layout says."""

    def _layouts(self) -> tuple[AgentLayout, ...]:
        everything = tuple(range(len(self.layout.state)))
        return tuple(
            replace(layout, observation=everything) for layout in super()._layouts()
        )


class DropsOut(Mabc):
    """Its actors are in training, and drop some of what they see."""

    def agents(self, number: int) -> Agents:
        found = super().agents(number)
        for agent in found.values():
            agent.actor.layers.insert(0, nn.Dropout(0.5))
        return found


class Shy(Actor):
    """A network that is another one when it is copied."""

    def __deepcopy__(self, memo: Any) -> Actor:
        self.__class__ = Actor  # type: ignore[assignment]
        other = deepcopy(self)
        self.__class__ = Shy
        with torch.no_grad():
            other.normalizer.mean.zero_()
        return other


class ExportsAnother(Mabc):
    """What is exported is not what acts."""

    def agents(self, number: int) -> Agents:
        found = super().agents(number)
        for agent in found.values():
            agent.actor.__class__ = Shy
        return found


class StaleCheckpoint(Td3Bc):
    """A checkpoint's actors are the targets."""

    def state(self, number: int) -> dict[str, Any]:
        state = super().state(number)
        return {**state, "actors": state["target_actors"], "own": state["actors"]}

    def load_states(self, states: Sequence[State]) -> None:
        super().load_states([{**state, "actors": state["own"]} for state in states])


class FillsNan(Mabc):
    """States that are not finite are taken to be 0."""

    def __init__(self, config: Any, arrays: Any, *rest: Any) -> None:
        known = replace(arrays, states=np.nan_to_num(arrays.states))
        super().__init__(config, known, *rest)


class ScalesRewards(Mabc):
    """The dataset's rewards are changed in place."""

    def __init__(self, config: Any, arrays: Any, *rest: Any) -> None:
        arrays.rewards[:] /= 10
        super().__init__(config, arrays, *rest)


class ChangesInfo(Mabc):
    """The dataset's step numbers are changed in place."""

    def __init__(self, config: Any, arrays: Any, *rest: Any) -> None:
        arrays.info["d_mm"][:] += 1
        super().__init__(config, arrays, *rest)


class Reseeds(Mabc):
    """torch's stream that belongs to nobody begins anew."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        torch.manual_seed(0)


class DrawsNumpys(Mabc):
    """It draws from numpy's stream that belongs to nobody, to no end."""

    def update(self) -> Tensors:
        np.random.rand()  # noqa: NPY002
        return super().update()


class DrawsPythons(Mabc):
    """It draws from Python's own stream, to no end."""

    def diagnose(self) -> Tensors:
        random.random()
        return super().diagnose()


class NanOnline(Ddpg):
    """A measured number is none."""

    def diagnose(self) -> dict[str, float]:
        return super().diagnose() | {"q/data": float("nan")}


class NeverLearnsOnline(Ddpg):
    """Its actors' updates are undone, but not their scales."""

    def learn(self, updates: int) -> dict[str, float]:
        actors = [agent.actor for agent in self.agents.values()]
        before = [deepcopy(dict(actor.named_parameters())) for actor in actors]
        measured = super().learn(updates)
        for actor, weights in zip(actors, before, strict=True):
            actor.load_state_dict(weights, strict=False)
        return measured


class ForgetsSteps(Ddpg):
    """Checkpoints lack the number of steps."""

    def state(self) -> dict[str, Any]:
        state = super().state()
        del state["env_steps"]
        return state

    def load_state(self, state: State) -> None:
        super().load_state({**state, "env_steps": 0})


class ForgetsStream(Ddpg):
    """The same batches come again when it resumes."""

    def load_state(self, state: State) -> None:
        own = super().state()
        super().load_state({**state, "rng": own["rng"]})


class Reckless(Explorer):
    """Explores without looking at bounds."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state) * np.float32(1.5)


class ExploresTooMuch(Ddpg):
    """Its own episodes are run beyond the actions' bounds."""

    def behaviour(self) -> Explorer:
        return Reckless(LearnedPolicy(self.name, self.agents, self.layout), 0.5, 0.5)


class LearnsOneSeed(Maddpg):
    """Its seed is left out."""

    def __init__(self, config: Any, judge: Any, seed: int, *rest: Any) -> None:
        super().__init__(config, judge, 0, *rest)


@dataclass
class LooseConfig:
    """Hyper-parameters that may change under way."""

    updates: int = 10
    batch_size: int = 16
    learning_rate: float = 5e-4
    future: float = 0.0
    hidden: tuple[int, ...] = (16,)
    std_floor: float = 0.01
    precision: str = "highest"


@dataclass(frozen=True)
class SetConfig(MabcConfig):
    """A hyper-parameter is a set."""

    entries: frozenset[str] = frozenset({"alpha"})


def planted(
    learner: type, base: str = "mabc", config: Any = None, name: str | None = None
) -> learners.Candidate:
    """A variant of an algorithm, by its own name."""
    usual = ALGORITHMS.get(base)
    own = name or f"planted-{learner.__name__}"
    named = type(learner.__name__, (learner,), {"name": own, "base_name": own})
    presets = {TUNED: config or usual.presets[TUNED]}
    return learners.Candidate(own, replace(usual, learner=named, presets=presets))


OTHER_WEIGHTS = "weight differ at"
NOT_ITS_WAY = "does not go the way that data draw it"

ALGORITHMS_MISTAKEN: list[tuple[learners.Candidate, Broken]] = [
    (
        replace(planted(Misnamed), name="planted-other"),
        {
            NAMES: "the learner calls itself 'planted-Misnamed'",
            RESUMES: "expected 'planted-other'",
        },
    ),
    (
        planted(GlobalWeights),
        {
            SEED: OTHER_WEIGHTS,
            TOGETHER: "seed 3 learns other weights beside another",
            ALONE: "it draws from torch's own stream",
        },
    ),
    (planted(OneSeed), {SEED: "two seeds learn the same"}),
    (planted(SharedStream), {TOGETHER: "seed 5 learns other weights"}),
    (planted(ForgetsOptimiser), {RESUMES: OTHER_WEIGHTS}),
    (planted(ForgetsTargets, "td3-bc"), {RESUMES: OTHER_WEIGHTS}),
    (planted(ForgetsStep), {RESUMES: "it resumes at update 0"}),
    (planted(ForgetsBatches), {RESUMES: OTHER_WEIGHTS}),
    (planted(ForgetsRhythm), {RESUMES: OTHER_WEIGHTS}),
    (planted(MeasuresGraph), {MEASURES: "size carries a graph: detach it"}),
    (planted(MeasuresNan), {MEASURES: "size is not finite"}),
    (planted(MeasuresMean), {MEASURES: "loss/end_effector has shape ()"}),
    (planted(BoundsNothing), {MEASURES: "bounds are of q/largest"}),
    (
        planted(NeverLearns),
        {LEARNS: "the actor end_effector stays as it is", OWN: NOT_ITS_WAY},
    ),
    (
        planted(OneLearns),
        {LEARNS: "the actor balance stays as it is", OWN: NOT_ITS_WAY},
    ),
    (planted(InTurn), {OWN: "delta_x does not go the way"}),
    (planted(InTurnOnline, "maddpg"), {OWN: "delta_x does not go the way"}),
    (
        planted(ActsTooMuch),
        {
            ACTS: "two agents: an action is outside of the action space",
            EXPORTS: "the export acts otherwise, by 3.4 of half a range",
            CHECKPOINT: "actions of the checkpoint differ",
        },
    ),
    (
        planted(SeesAll, "matd3-bc"),
        {
            ACTS: "two agents: end_effector acts on what it does not see",
            CHECKPOINT: "Error(s) in loading state_dict",
        },
    ),
    (
        planted(DropsOut),
        {
            ACTS: "two agents: actions differ",
            EXPORTS: "the export acts otherwise",
            CHECKPOINT: "actions of the checkpoint differ",
        },
    ),
    (planted(ExportsAnother), {EXPORTS: "the export acts otherwise"}),
    (
        planted(StaleCheckpoint, "td3-bc"),
        {CHECKPOINT: "actions of the checkpoint differ"},
    ),
    (planted(FillsNan), {ODD: "NaN in states is accepted"}),
    (planted(ScalesRewards), {ALONE: "the data's rewards differ"}),
    (planted(ChangesInfo), {ALONE: "the data's d_mm differ"}),
    (planted(Reseeds), {ALONE: "it draws from torch's own stream"}),
    (planted(DrawsNumpys), {ALONE: "it draws from numpy's own stream"}),
    (planted(DrawsPythons), {ALONE: "it draws from Python's own stream"}),
    (planted(NanOnline, "ddpg"), {MEASURES: "q/data is nan"}),
    (
        planted(NeverLearnsOnline, "ddpg"),
        {LEARNS: "the actor joint stays as it is", OWN: NOT_ITS_WAY},
    ),
    (planted(ForgetsSteps, "ddpg"), {RESUMES: "env_steps are 146, resumed 0"}),
    (planted(ForgetsStream, "ddpg"), {RESUMES: OTHER_WEIGHTS}),
    (planted(ExploresTooMuch, "ddpg"), {ACTS: "it explores outside"}),
    (planted(LearnsOneSeed, "maddpg"), {SEED: "two seeds learn the same"}),
    (
        planted(Mabc, config=LooseConfig(), name="planted-LooseConfig"),
        {NAMES: "preset tuned is no frozen dataclass"},
    ),
    (
        planted(Mabc, config=SetConfig(), name="planted-SetConfig"),
        {
            NAMES: "frozenset is not JSON serializable",
            RESUMES: "other Python objects than numbers",
            CHECKPOINT: "other Python objects than numbers",
        },
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("about", "expected"),
    [pytest.param(*case, id=case[0].name[8:]) for case in ALGORITHMS_MISTAKEN],
)
def test_an_algorithms_mistake_breaks_its_claims(
    about: learners.Candidate, expected: Broken
) -> None:
    costly = [claim for claim in (EXPORTS,) if claim not in expected]
    expect(of_algorithm(about, but=costly), expected)


# --- Mistakes of collectors --------------------------------------------------

SETTINGS = "its settings can be recorded"
BOUNDS = "its actions are finite and within their bounds"
EPISODES = "episodes follow from their seeds to the bit"
FORGETS = "an episode does not depend on those before"
PROCESSES = "episodes are the same in several processes"
KEEPS = "what it keeps depends on the episode alone"
COPIES = "a dataset of it passes verify, and replays to the bit"


class Flawless(RandomPolicy):
    """It makes no mistake."""


class Stray(RandomPolicy):
    """Actions come from numpy's stream that belongs to nobody."""

    def act(self, state: np.ndarray) -> np.ndarray:
        drawn = np.random.uniform(self._low, self._high)  # noqa: NPY002
        return drawn.astype(np.float32)


class Haunted(PdPolicy):
    """It begins with the hand of the last episode."""

    _last_ee: np.ndarray | None = None

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        last = self._last_ee
        super().begin(rng, layout)
        self._last_ee = last


class Precise(RandomPolicy):
    """Its actions are float64."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state).astype(np.float64)


class Wild(RandomPolicy):
    """Its actions are beyond their bounds, now and then."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state) * np.float32(1.2)


class Lost(RandomPolicy):
    """Its actions are no numbers where the base is."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state) + np.float32(np.nan)


class Nameless(RandomPolicy):
    """It keeps the name of the one that it was made of."""


class Placed(RandomPolicy):
    """What it does depends on the process that it is in."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state) * np.float32(1 / (1 + os.getpid() % 1_000))


class Rooted(RandomPolicy):
    """It cannot go to another process."""

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        self.scale = lambda x: x


class Vague(RandomPolicy):
    """Its settings are no JSON."""

    def describe(self) -> dict[str, Any]:
        return {"low": np.zeros(2)}


@dataclass(frozen=True)
class Parts:
    """Settings of which one is a set."""

    entries: frozenset[str] = frozenset({"alpha"})


@dataclass
class Loose:
    """Settings that may change under way."""

    noise: float = 0.0


@dataclass(frozen=True)
class Fleeting:
    """Settings whose default is another one each time."""

    when: int = field(default_factory=time.perf_counter_ns)


def every_second() -> Callable[[Episode], bool]:
    """Keeps every second episode that it is asked about."""
    asked: list[Episode] = []

    def keeps(episode: Episode) -> bool:
        asked.append(episode)
        return len(asked) % 2 == 0

    return keeps


def gathered(
    policy: type[Any],
    name: str = "",
    task: str = "Reach-v0",
    config: type = RandomConfig,
    keeps: Callable[[Episode], Any] = lambda episode: True,
) -> collectors.Candidate:
    """A collector of a variant of a policy."""

    def make(config: Any, task: Task) -> Policy:
        made: Any = policy(config)
        made.name = made.name if policy is Nameless else own
        acting: Policy = made
        return acting

    own = f"planted-{name or policy.__name__}"
    made = Collector(about="Planted.", config=config, policy=make, keeps=keeps)
    usual = collectors.candidate("random", task)
    return replace(usual, name=own, collector=made)


NO_NUMBERS = "InvalidActionError: action is [nan, nan, nan, nan]"

COLLECTORS_MISTAKEN: list[tuple[collectors.Candidate, Broken]] = [
    (
        gathered(Stray),
        {
            EPISODES: "the same seed: states differ at [1, 0]",
            FORGETS: "an episode after others: states differ at [1, 0]",
            PROCESSES: "in two processes: states differ at [1, 0]",
        },
    ),
    (
        gathered(Haunted, config=PdConfig),
        {
            FORGETS: "an episode after others: states differ at [1, 0]",
            PROCESSES: "in two processes: states differ at [1, 0]",
        },
    ),
    (gathered(Precise), {BOUNDS: "an action is float64 of shape (4,)"}),
    (gathered(Wild), {BOUNDS: "an action is outside of the action space"}),
    (
        gathered(Lost),
        {BOUNDS: "an action is not finite"}
        | dict.fromkeys((EPISODES, FORGETS, KEEPS, COPIES), NO_NUMBERS),
    ),
    (gathered(Nameless), {SETTINGS: "its policy calls itself 'random'"}),
    (gathered(Placed), {PROCESSES: "in two processes: states differ at [1, 0]"}),
    (gathered(Rooted), {PROCESSES: "Can't pickle local object"}),
    (gathered(Vague), {SETTINGS: "ndarray is not JSON serializable"}),
    (
        gathered(Flawless, "Parts", config=Parts),
        dict.fromkeys((SETTINGS, COPIES), "is not JSON serializable"),
    ),
    (
        gathered(Flawless, "Loose", config=Loose),
        {SETTINGS: "its config is no frozen dataclass"},
    ),
    (
        gathered(Flawless, "Fleeting", config=Fleeting),
        {SETTINGS: "two default configs differ"},
    ),
    (
        gathered(Flawless, "Turns", keeps=every_second()),
        {KEEPS: "keeps says something else of the same episode"},
    ),
    (
        gathered(Flawless, "Yes", keeps=lambda episode: "yes"),
        {KEEPS: "keeps says 'yes', expected a bool"},
    ),
    (
        gathered(
            Flawless,
            "Reasons",
            "CarryReach-v0",
            keeps=lambda episode: episode.reason is None,
        ),
        {KEEPS: "keeps says something else of the same episode"},
    ),
    (gathered(Flawless, keeps=lambda episode: episode.rewards.sum() > -5), {}),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("about", "expected"),
    [pytest.param(*case, id=case[0].name[8:]) for case in COLLECTORS_MISTAKEN],
)
def test_a_collectors_mistake_breaks_its_claims(
    about: collectors.Candidate, expected: Broken, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT)  # workers import this file
    costly = [claim for claim in (PROCESSES,) if claim not in expected]
    expect(of_collector(about, but=costly), expected)


# --- The command line --------------------------------------------------------

PLUGIN = """
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm

class Planted(Mabc):
    name = "planted-{name}"

ALGORITHMS.add(
    "planted-mabc",
    Algorithm(
        about="Planted.", source="", learner=Planted, presets={{TUNED: MabcConfig()}}
    ),
)
"""


def run(*arguments: str) -> int:
    """Exit code of the command, as the shell would see it."""
    try:
        return main(["check", *arguments])
    except SystemExit as end:  # from the parser of options
        return int(end.code or 0)


def complaint(output: Output) -> str:
    """The only line on stderr; nothing is on stdout."""
    captured = output.readouterr()
    (line,) = captured.err.splitlines()
    assert captured.out == ""
    assert line.startswith("marl-mm: ")
    return str(line)


@pytest.fixture
def plug_in(tmp_path: Path) -> Callable[[str], str]:
    """Writes a plug-in of this code."""

    def write(code: str) -> str:
        path = tmp_path / "planted.py"
        path.write_text(code)
        return str(path)

    return write


@pytest.mark.slow
def test_check_of_a_sound_plug_in_ends_with_0(
    plug_in: Callable[[str], str], capsys: Output
) -> None:
    path = plug_in(PLUGIN.format(name="mabc"))
    assert run(path) == 0
    lines = capsys.readouterr().out.splitlines()
    about = learners.candidate("planted-mabc")
    claims = algorithms.algorithm_claims(about)
    assert lines == [f"holds  algorithm planted-mabc: {claim}" for claim in claims]
    assert run("planted-mabc") == 0  # by its name, once it is there
    assert capsys.readouterr().out.splitlines() == lines


@pytest.mark.slow
@pytest.mark.parametrize("as_json", [False, True], ids=["words", "json"])
def test_check_of_a_plug_in_with_a_mistake_ends_with_1(
    plug_in: Callable[[str], str], capsys: Output, as_json: bool
) -> None:
    path = plug_in(PLUGIN.format(name="other"))
    assert run(path, *(["--json"] if as_json else [])) == 1
    captured = capsys.readouterr()
    assert captured.err.splitlines()[-1].startswith("marl-mm: 2 of ")
    why = "the learner calls itself 'planted-other'"
    if as_json:
        findings = [Finding(**values) for values in json.loads(captured.out)]
        assert {finding.subject for finding in findings} == {"algorithm planted-mabc"}
        expect(broken(findings), {NAMES: why, RESUMES: "expected 'planted-mabc'"})
    else:
        first, *rest = captured.out.splitlines()
        assert first == f"fails  algorithm planted-mabc: {NAMES}: {why}"
        assert sum(line.startswith("fails ") for line in rest) == 1


@pytest.mark.slow
def test_json_of_a_task_is_all_there_is_on_stdout(capsys: Output) -> None:
    """PettingZoo's own tests print that they pass."""
    assert run("Reach-v0", "--json") == 0
    findings = [Finding(**values) for values in json.loads(capsys.readouterr().out)]
    assert [finding.claim for finding in findings] == list(tasks.task_claims(None))  # type: ignore[arg-type]


def test_check_of_an_unknown_name_ends_with_2(capsys: Output) -> None:
    assert run("planted-nothing") == 2
    assert "planted-nothing" in complaint(capsys)
    assert run("planted_nothing.py") == 2
    assert "planted_nothing.py" in complaint(capsys)


def test_check_of_nothing_ends_with_2(capsys: Output) -> None:
    assert run() == 2
    assert "name a plug-in" in complaint(capsys)


def test_check_of_a_plug_in_that_raises_ends_with_1_and_one_line(
    plug_in: Callable[[str], str], capsys: Output
) -> None:
    assert run(plug_in("\n\nraise ValueError('planted')")) == 1
    line = complaint(capsys)
    assert "plug-in planted.py fails: ValueError: planted" in line
    assert "(line 3)" in line


def test_check_of_a_plug_in_that_registers_nothing_ends_with_2(
    plug_in: Callable[[str], str], capsys: Output
) -> None:
    path = plug_in("planted = 1")
    assert run(path) == 2
    assert "registers no task, algorithm, collector or metric" in complaint(capsys)


FINITE = "it is a finite number, or None"
FOLLOWS = "it follows from the episode, which stays as it is"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (len, {}),
        (lambda episode: math.inf, {FINITE: "it is inf"}),
        (lambda episode: "long", {FINITE: "expected a number or None"}),
        (lambda episode: random.random(), {FOLLOWS: ", then 0."}),
        (lambda episode: episode.rewards.fill(0.0), {FOLLOWS: "changes the episode"}),
    ],
    ids=["none", "endless", "text", "chance", "changes"],
)
def test_a_metrics_mistake_breaks_its_claims(
    value: Callable[..., Any], expected: Broken
) -> None:
    metric, some = Metric(about="x", value=value), episodes(short("Reach-v0"))
    about = metrics.Candidate("planted", metric, some)
    found = broken(examine(about.name, about, metrics.metric_claims(about)))
    expect(found, expected)
