"""The contracts: what is built in keeps to them, and planted mistakes are found."""

import copy
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from marl_mm import plugins
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.cli import main
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.contracts import algorithms, collectors, tasks
from marl_mm.contracts.claims import examine
from marl_mm.envs.registry import TASKS, register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Task, Terms, Values
from marl_mm.envs.tasks.reach import Reach
from marl_mm.layout import Layout
from marl_mm.registry import BUILT_IN, Registry

EXAMPLES = Path(__file__).parents[1] / "examples" / "plugins"

REGISTRIES: tuple[Registry[Any], ...] = (ALGORITHMS, TASKS, COLLECTORS)


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """What a test registers goes with it."""
    for registry in REGISTRIES:
        registry.names()
    kept = [(dict(one._things), dict(one._origins)) for one in REGISTRIES]
    loaded = dict(plugins._loaded)
    yield
    for registry, (things, origins) in zip(REGISTRIES, kept, strict=True):
        registry._things, registry._origins = things, origins
    plugins._loaded.clear()
    plugins._loaded.update(loaded)


def broken(about: Any, claims: Mapping[str, Any]) -> dict[str, str]:
    """Claims that do not hold, and why."""
    found = examine("planted", about, claims)
    return {one.claim: one.broken for one in found if one.broken}


def built_in(registry: Registry[Any]) -> list[str]:
    return [name for name in registry.names() if registry.origin(name) == BUILT_IN]


def named(value: Any) -> str:
    return getattr(value, "__name__", "")


@pytest.mark.slow
@pytest.mark.parametrize("name", built_in(TASKS))
def test_every_task_keeps_to_its_contract(name: str) -> None:
    about = tasks.short(name)
    assert broken(about, tasks.task_claims(about)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", built_in(ALGORITHMS))
def test_every_algorithm_keeps_to_its_contract(name: str) -> None:
    about = algorithms.named(name)
    assert broken(about, algorithms.algorithm_claims(about)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", built_in(COLLECTORS))
def test_every_collector_keeps_to_its_contract(name: str) -> None:
    about = collectors.named(name)
    assert broken(about, collectors.collector_claims(about)) == {}


# --- Planted in tasks --------------------------------------------------------

COMPLETE = "its layout is complete, and states are within it"
TASK_SEEDS = "episodes follow from their seeds to the bit"
NUMBERS = "its step numbers and rewards are finite"
HINDSIGHT = "rewards in hindsight are those online to the bit"
GOALS = "goals of evaluations are its own"
EXPERT = "its expert sets every entry within its bounds"
TRAVELS = "it travels to workers and into records"

Goal = np.ndarray | None


class Global(Reach):
    """Draws from a stream that is not the episode's."""

    def begin(self, attempt: Attempt, rng: np.random.Generator, goal: Goal) -> None:
        x = np.random.uniform(1.0, 1.5)  # noqa: NPY002
        super().begin(attempt, rng, np.array([x, 0.0, 0.6]) if goal is None else goal)


class Remembers(Reach):
    """What was before the episode goes into it."""

    def begin(self, attempt: Attempt, rng: np.random.Generator, goal: Goal) -> None:
        super().begin(attempt, rng, goal)
        drive: Any = attempt.drives[0]
        drive.count = getattr(drive, "count", 0) + 1
        attempt.memory.alpha = 1.0 / drive.count


class Forgets(Reach):
    """Leaves an entry of the state out."""

    def observe(self, attempt: Attempt) -> Values:
        told = dict(super().observe(attempt))
        del told["base_yaw"]
        return told


class Chatters(Reach):
    """Tells an entry that the layout has not."""

    def observe(self, attempt: Attempt) -> Values:
        return {**super().observe(attempt), "wind": 0.0}


class Beyond(Reach):
    """Tells a control mode beyond its bounds."""

    def observe(self, attempt: Attempt) -> Values:
        return {**super().observe(attempt), "control_mode": 1.5}


class NotANumber(Reach):
    """Measures what is none."""

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        return {**super().measure(attempt), "d_mm": float("nan")}


class Wordy(Reach):
    """Measures words."""

    own_info = {**Reach.own_info, "mood": "of the robot"}  # noqa: RUF012

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        return {**super().measure(attempt), "mood": "fine"}


class Unmeasured(Reach):
    """Promises a step number that it does not measure."""

    own_info = {**Reach.own_info, "wind": "of the day [m/s]"}  # noqa: RUF012


class Modest(Reach):
    """Says that no return passes what a reward passes."""

    @property
    def highest_return(self) -> float:
        return -100.0


class Needy(Reach):
    """Its rewards need what nothing tells."""

    needs = (*Reach.needs, "wind")


class Twofaced(Reach):
    """Rewards one step otherwise than many."""

    def reward(self, achieved: Any, desired: Any, terms: Terms) -> np.ndarray:
        reward = super().reward(achieved, desired, terms)
        return reward + 1.0 if np.ndim(reward) == 0 else reward


class Lonely(Reach):
    """Rewards all steps together."""

    def reward(self, achieved: Any, desired: Any, terms: Terms) -> np.ndarray:
        return np.asarray(super().reward(achieved, desired, terms).mean())


class Backwards(Reach):
    """Rewards what is far from the goal."""

    def reward(self, achieved: Any, desired: Any, terms: Terms) -> np.ndarray:
        return self.distance(achieved, desired)


class Fails(Reach):
    """Fails, and in hindsight does not."""

    def failure(self, attempt: Attempt) -> str:
        return "tired" if attempt.steps == 2 else ""

    def judge(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> tuple[np.ndarray, np.ndarray]:
        places = achieved, desired, terms
        return self.reward(*places), self.reached(*places)


class Clueless(Reach):
    """Has an expert that leaves alpha out."""

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        told = dict(super().expert(state, script))
        del told["alpha"]
        return told


class Rash(Reach):
    """Has an expert that asks for more than there is."""

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        return {**super().expert(state, script), "delta_z": 7.0}


_calls: list[int] = []


def counted() -> int:
    """Another number at each call."""
    _calls.append(0)
    return len(_calls)


class Fickle(Reach):
    """Has goals that depend on how many were asked for before."""

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        return 1.0 + 0.001 * counted(), 0.0, 0.6


class Deaf(Reach):
    """Does not take the goal that it is given."""

    def begin(self, attempt: Attempt, rng: np.random.Generator, goal: Goal) -> None:
        super().begin(attempt, rng, None)


@dataclass(frozen=True, kw_only=True)
class Stuck(Reach):
    """Holds what no process can send to another."""

    rule: Callable[[float], float] = field(default=lambda x: x)


TASKS_WITH_MISTAKES: list[tuple[type[Task], str, str]] = [
    (Global, TASK_SEEDS, COMPLETE),
    (Remembers, TASK_SEEDS, HINDSIGHT),
    (Forgets, COMPLETE, TRAVELS),
    (Chatters, COMPLETE, TASK_SEEDS),
    (Beyond, COMPLETE, TASK_SEEDS),
    (NotANumber, NUMBERS, EXPERT),
    (Wordy, NUMBERS, EXPERT),
    (Unmeasured, NUMBERS, TRAVELS),
    (Modest, NUMBERS, HINDSIGHT),
    (Needy, HINDSIGHT, EXPERT),
    (Twofaced, HINDSIGHT, TASK_SEEDS),
    (Lonely, HINDSIGHT, TASK_SEEDS),
    (Backwards, HINDSIGHT, TASK_SEEDS),
    (Fails, HINDSIGHT, TASK_SEEDS),
    (Clueless, EXPERT, HINDSIGHT),
    (Rash, EXPERT, HINDSIGHT),
    (Fickle, GOALS, HINDSIGHT),
    (Deaf, GOALS, HINDSIGHT),
    (Stuck, TRAVELS, HINDSIGHT),
]
"""Each with the claim that it breaks, and one that it keeps."""


@pytest.mark.parametrize(("kind", "claim", "kept"), TASKS_WITH_MISTAKES, ids=named)
def test_a_tasks_mistake_is_found(kind: type[Task], claim: str, kept: str) -> None:
    register_task("planted-v0", kind())
    about = tasks.short("planted-v0")
    claims = tasks.task_claims(about)
    found = broken(about, {words: claims[words] for words in (claim, kept)})
    assert list(found) == [claim]


# --- Planted in algorithms ---------------------------------------------------

RECORDED = "its name and hyper-parameters can be recorded"
SEEDED = "what it learns follows from its seed to the bit"
RESUMES = "it resumes to the bit"
TOGETHER = "several seeds at once learn what each learns alone"
MEASURES = "what it measures is finite, one number a seed"
LEARNS = "it learns"
ACTS = "actions are within their bounds, for any team"
EXPORTS = "an exported policy acts as it does"
ALONE = "a checkpoint acts without it"
REFUSES = "NaN in data is refused"
LEAVES = "data and others' random streams are left alone"


class OtherName(Mabc):
    name = "mbac"


class Unseeded(Mabc):
    """Takes its weights from torch's own stream."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for network in self.actors.networks.values():
            with torch.no_grad():
                network.flat.copy_(torch.randn_like(network.flat))


class Seedless(Mabc):
    """Learns the same whatever the seed."""

    def __init__(self, config: Any, arrays: Any, judge: Any, seeds: Any, *rest: Any):
        super().__init__(config, arrays, judge, [0 for _ in seeds], *rest)


class Amnesiac(Mabc):
    """Loses what Adam knows."""

    lost = "actor_learners"

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        own = [self.state(number)[self.lost] for number in range(len(states))]
        pairs = zip(states, own, strict=True)
        super().load_states([{**state, self.lost: fresh} for state, fresh in pairs])


class Restarts(Amnesiac):
    """Draws its batches again from the first."""

    lost = "batches"


class Timeless(Mabc):
    """Forgets how far it was."""

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        super().load_states(states)
        self.step = 0


class Untargeted(Td3Bc):
    """Forgets its target networks."""

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        super().load_states(states)
        self._target_critics = self.critics.copy()


class Shared(Mabc):
    """Shows all seeds the batches of the first."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        streams = self._batches._streams
        self._batches._streams = [copy.deepcopy(streams[0]) for _ in streams]


class Graphs(Mabc):
    """Measures with all that led to it."""

    def update(self) -> dict[str, torch.Tensor]:
        measured = super().update()
        return {key: value.clone().requires_grad_() for key, value in measured.items()}


class Averages(Mabc):
    """Measures one number for all seeds."""

    def update(self) -> dict[str, torch.Tensor]:
        return {key: value.mean() for key, value in super().update().items()}


class Uncertain(Mabc):
    """Measures a number that is none."""

    def diagnose(self) -> dict[str, torch.Tensor]:
        return {**super().diagnose(), "nan": torch.full((len(self.seeds),), torch.nan)}


class Bounded(Mabc):
    """Bounds what nobody measures."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.bounds["wind"] = 1.0


class Lazy(Mabc):
    """Only counts."""

    def update(self) -> dict[str, torch.Tensor]:
        self.step += 1
        return {"loss/actor": torch.zeros(len(self.seeds))}


class Acting(Mabc):
    """Does something else than its actors say."""

    def changed(self, action: np.ndarray) -> np.ndarray:
        return action

    def agents(self, number: int) -> dict[str, Any]:
        found: dict[str, Any] = super().agents(number)
        for agent in found.values():
            agent.act = lambda seen, own=agent.act: self.changed(own(seen))
        return found


class Damped(Acting):
    """Does half."""

    def changed(self, action: np.ndarray) -> np.ndarray:
        return np.asarray(action / 2, np.float32)


class Restless(Acting):
    """Does something else each time."""

    def changed(self, action: np.ndarray) -> np.ndarray:
        return np.asarray(action * 0 + counted() % 97 / 100, np.float32)


class Strong(Acting):
    """Asks for more than there is."""

    def changed(self, action: np.ndarray) -> np.ndarray:
        return np.asarray(action + 3, np.float32)


class Credulous(Mabc):
    """Takes NaN for data."""

    def __init__(self, config: Any, arrays: Any, *rest: Any) -> None:
        whole = {n: np.nan_to_num(getattr(arrays, n)) for n in ("states", "rewards")}
        super().__init__(config, replace(arrays, **whole), *rest)


class Meddles(Mabc):
    """Changes the data that it is given."""

    def __init__(self, config: Any, arrays: Any, *rest: Any) -> None:
        super().__init__(config, arrays, *rest)
        arrays.states[:] += 1.0


class Reseeds(Mabc):
    """Seeds torch for everybody."""

    def update(self) -> dict[str, torch.Tensor]:
        torch.manual_seed(0)
        return super().update()


ALGORITHMS_WITH_MISTAKES: list[tuple[type[Any], str, str]] = [
    (OtherName, RECORDED, SEEDED),
    (Unseeded, SEEDED, ALONE),
    (Seedless, SEEDED, ALONE),
    (Amnesiac, RESUMES, SEEDED),
    (Restarts, RESUMES, SEEDED),
    (Timeless, RESUMES, SEEDED),
    (Untargeted, RESUMES, SEEDED),
    (Shared, TOGETHER, RESUMES),
    (Graphs, MEASURES, SEEDED),
    (Averages, MEASURES, SEEDED),
    (Uncertain, MEASURES, SEEDED),
    (Bounded, MEASURES, SEEDED),
    (Lazy, LEARNS, RECORDED),
    (Restless, ACTS, SEEDED),
    (Strong, ACTS, SEEDED),
    (Damped, EXPORTS, SEEDED),
    (Damped, ALONE, ACTS),
    (Credulous, REFUSES, SEEDED),
    (Meddles, LEAVES, RECORDED),
    (Reseeds, LEAVES, SEEDED),
]


@pytest.mark.parametrize(("kind", "claim", "kept"), ALGORITHMS_WITH_MISTAKES, ids=named)
def test_an_algorithms_mistake_is_found(
    kind: type[Any], claim: str, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Td3BcConfig() if issubclass(kind, Td3Bc) else MabcConfig()
    if kind is not OtherName:
        monkeypatch.setattr(kind, "name", "planted")
    made = Algorithm(about="", source="", learner=kind, presets={TUNED: config})
    about = algorithms.Named("planted", made)
    claims = algorithms.algorithm_claims(about)
    found = broken(about, {words: claims[words] for words in (claim, kept)})
    assert list(found) == [claim]


Loose: Any = make_dataclass(
    "Loose", [(f.name, f.type, field(default=f.default)) for f in fields(MabcConfig)]
)
"""Hyper-parameters that can change."""


def test_hyper_parameters_that_can_change_are_found() -> None:
    made = Algorithm(about="", source="", learner=Mabc, presets={TUNED: Loose()})
    about = algorithms.Named("mabc", made)
    found = broken(about, {RECORDED: algorithms.algorithm_claims(about)[RECORDED]})
    assert "no frozen dataclass" in found[RECORDED]


# --- Planted in collectors ---------------------------------------------------

SETTINGS = "its settings can be recorded"
BOUNDS = "its actions are finite and within their bounds"
ON_ITS_OWN = "an episode does not depend on those before"
PROCESSES = "episodes are the same in several processes"
KEEPS = "what it keeps depends on the episode alone"


class Planted(RandomPolicy):
    name = "planted"


class Nameless(RandomPolicy):
    name = "another"


class Unsaid(Planted):
    """Describes itself by what no file takes."""

    def describe(self) -> dict[str, Any]:
        return {"kinds": {1, 2}}


class Wild(Planted):
    """Asks for more than there is."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return np.float32(2) * super().act(state)


class Blurred(Planted):
    """Acts in another type."""

    def act(self, state: np.ndarray) -> np.ndarray:
        return super().act(state).astype(np.float64)


class Elsewhere(Planted):
    """Draws from numpy's own stream."""

    def act(self, state: np.ndarray) -> np.ndarray:
        drawn = np.random.uniform(self._low, self._high)  # noqa: NPY002
        return drawn.astype(np.float32)


class Tired(Planted):
    """Does less with every episode."""

    begun = 0

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        super().begin(rng, layout)
        self.begun += 1

    def act(self, state: np.ndarray) -> np.ndarray:
        return (super().act(state) / self.begun).astype(np.float32)


class Local(Planted):
    """Does what the process is called."""

    def act(self, state: np.ndarray) -> np.ndarray:
        action = super().act(state)
        action[0] = os.getpid() % 997 / 1000
        return action


COLLECTORS_WITH_MISTAKES: list[tuple[type[Any], str, str]] = [
    (Nameless, SETTINGS, TASK_SEEDS),
    (Unsaid, SETTINGS, TASK_SEEDS),
    (Wild, BOUNDS, TASK_SEEDS),
    (Blurred, BOUNDS, TASK_SEEDS),
    (Elsewhere, TASK_SEEDS, SETTINGS),
    (Tired, ON_ITS_OWN, BOUNDS),
    (Local, PROCESSES, TASK_SEEDS),
]


def collector(kind: type[Any], **more: Any) -> collectors.Named:
    made = Collector(
        about="", config=RandomConfig, policy=lambda config, task: kind(config), **more
    )
    return replace(collectors.named("random"), name="planted", collector=made)


@pytest.mark.parametrize(("kind", "claim", "kept"), COLLECTORS_WITH_MISTAKES, ids=named)
def test_a_collectors_mistake_is_found(kind: type[Any], claim: str, kept: str) -> None:
    about = collector(kind)
    claims = collectors.collector_claims(about)
    found = broken(about, {words: claims[words] for words in (claim, kept)})
    assert list(found) == [claim]


def test_moods_in_what_is_kept_are_found() -> None:
    for keeps in (lambda episode: counted() % 2 == 0, lambda episode: "yes"):
        about = collector(Planted, keeps=keeps)
        claims = collectors.collector_claims(about)
        found = broken(about, {words: claims[words] for words in (KEEPS, SETTINGS)})
        assert list(found) == [KEEPS]


# --- The command -------------------------------------------------------------


def run(*words: object) -> int:
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)


def test_the_command_says_what_holds_and_what_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", EXAMPLES / "noisy_pd.py") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7
    assert all(line.startswith("holds  collector noisy-pd: ") for line in lines)
    mistake = tmp_path / "mistake.py"
    mistake.write_text(
        "from marl_mm.envs import register_task\n"
        "from marl_mm.envs.tasks.reach import Reach\n"
        "class Rash(Reach):\n"
        "    def expert(self, state, script):\n"
        "        return {**super().expert(state, script), 'delta_z': 7.0}\n"
        "register_task('Rash-v0', Rash())\n"
    )
    assert run("check", mistake, "--json") == 1
    told = capsys.readouterr()
    (only,) = [one for one in json.loads(told.out) if one["broken"]]
    assert only["claim"] == EXPERT and "delta_z" in only["broken"]
    assert "1 of 12 claims do not hold" in told.err.splitlines()[-1]


def test_what_cannot_be_checked_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "nothing.py").write_text("x = 1\n")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    for code, what, message in (
        (2, (), "name a plug-in"),
        (2, ("nobody",), "no plug-in 'nobody'"),
        (2, (tmp_path / "nothing.py",), "registers no task, algorithm or collector"),
        (1, (tmp_path / "broken.py",), "ZeroDivisionError"),
    ):
        assert run("check", *what) == code
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line


def test_errors_in_strangers_code_are_told() -> None:
    def fails(about: object) -> None:
        raise ZeroDivisionError("of theirs")

    (finding,) = examine("somebody", None, {"it works": fails})
    assert finding.broken == "ZeroDivisionError: of theirs"
