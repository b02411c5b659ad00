"""Several robots in one episode, any number of agents, and terms of every tick."""

from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.contracts.claims import examine
from marl_mm.contracts.episodes import short
from marl_mm.contracts.tasks import task_claims
from marl_mm.datasets.dataset import load_dataset
from marl_mm.envs.core import EpisodeCore, motion_info
from marl_mm.envs.drive import Motion, Tick
from marl_mm.envs.order import Order
from marl_mm.envs.registry import register_task
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import Attempt, ScriptConfig, Task, Terms, Values
from marl_mm.envs.tasks.bar import Bar
from marl_mm.envs.tasks.reach import LAYOUT, Reach
from marl_mm.errors import UsageError
from marl_mm.eval.video import film_episode
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import Camera

SIDES = ("left", "right")


def sided(side: str, entries: tuple[Entry, ...]) -> tuple[Entry, ...]:
    return tuple(replace(entry, name=f"{side}_{entry.name}") for entry in entries)


def both(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for side in SIDES for name in names)


PAIR = Layout(
    tuple(entry for side in SIDES for entry in sided(side, LAYOUT.state)),
    tuple(entry for side in SIDES for entry in sided(side, LAYOUT.action)),
    tuple(
        Agent(
            f"{side}_{agent.name}",
            tuple(f"{side}_{name}" for name in agent.sees),
            tuple(f"{side}_{name}" for name in agent.sets),
        )
        for side in SIDES
        for agent in LAYOUT.team
    ),
    both(LAYOUT.compared),
    both(LAYOUT.desired),
)


@dataclass(frozen=True, kw_only=True)
class Pair(Task):
    """Two robots that both have to reach: it is made of two attempts at Reach."""

    about = "Two robots reach, each its own goal."
    layout = PAIR
    robots = 2

    reach: Reach = field(default_factory=lambda: Reach(success_distance=0.1))

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        attempt.memory = [Attempt(self.reach, [drive]) for drive in attempt.drives]
        for number, own in enumerate(attempt.memory):
            part = None if goal is None else goal[3 * number : 3 * number + 3]
            self.reach.begin(own, rng, part)
        attempt.goal = np.concatenate([own.goal for own in attempt.memory])

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        orders = []
        for side, own in zip(SIDES, attempt.memory, strict=True):
            part = {name: action[f"{side}_{name}"] for name in LAYOUT.action_names}
            orders += self.reach.act(own, part)
        return orders

    def observe(self, attempt: Attempt) -> Values:
        return {
            f"{side}_{name}": value
            for side, own in zip(SIDES, attempt.memory, strict=True)
            for name, value in self.reach.observe(own).items()
        }

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        near = [
            self.reach.reached(achieved[..., part], desired[..., part], terms)
            for part in (slice(0, 3), slice(3, 6))
        ]
        return np.asarray(near[0] & near[1])

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        hit = self.reached(achieved, desired, terms)
        return np.where(hit, 10.0, -self.distance(achieved, desired))

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        action: dict[str, float] = {}
        for side in SIDES:
            seen = {name: state[f"{side}_{name}"] for name in LAYOUT.state_names}
            own = self.reach.expert(seen, script)
            action |= {f"{side}_{name}": value for name, value in own.items()}
        return action


@dataclass(frozen=True, kw_only=True)
class Quiet(Reach):
    """Reach that is lost when the base accelerates too much at any tick."""

    own_info = {**Reach.own_info, "peak": "base's largest acceleration [m/s^2]"}  # noqa: RUF012

    most: float = 0.3

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        attempt.memory.peak = 0.0
        return super().act(attempt, action)

    def at_tick(self, attempt: Attempt, tick: Tick) -> None:
        now = abs(float(tick.command.acceleration[0]))
        attempt.memory.peak = max(attempt.memory.peak, now)

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        return {**super().measure(attempt), "peak": attempt.memory.peak}

    def failure(self, attempt: Attempt) -> str:
        return "too fast" if attempt.memory.peak > self.most else ""


@pytest.fixture(autouse=True)
def registered(registries: None) -> None:
    register_task("Pair-v0", Pair())
    register_task("Quiet-v0", Quiet())


def test_a_step_number_of_every_task_is_not_a_tasks_own() -> None:
    class Cup(Quiet):
        own_info = {**Quiet.own_info, "tilt": "tilt of the cup [deg]"}  # noqa: RUF012

    with pytest.raises(UsageError, match="own_info of Cup has 'tilt'"):
        register_task("Cup-v0", Cup())


@dataclass(frozen=True, kw_only=True)
class Watched(Bar):
    """Bar with a task that looks at every tick."""

    seen: ClassVar[set[tuple[Any, ...]]] = set()

    def at_tick(self, attempt: Attempt, tick: Tick) -> None:
        memory = type(attempt.memory).__name__
        self.seen.add((memory, len(attempt.drives), tick.robot))


def test_unseen_ticks_of_a_task_of_two_robots_are_of_both() -> None:
    with closing(EpisodeCore(Watched())) as core:
        core.reset(np.random.default_rng(0))
    assert Watched.seen == {("Pair", 2, 0), ("Pair", 2, 1)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Pair-v0", "Quiet-v0"])
def test_they_keep_to_the_contract_of_tasks(name: str) -> None:
    about = short(name)
    found = examine(name, about, task_claims(about))
    assert {finding.claim: finding.broken for finding in found if finding.broken} == {}


def test_two_robots_do_side_by_side_what_each_does_alone() -> None:
    """To the bit; the worst of their motions is the episode's."""
    plan = EpisodePlan(0, 5)
    rng = np.random.default_rng(0)
    actions = rng.uniform(LAYOUT.low, LAYOUT.high, (3, 2, 4))
    with closing(EpisodeCore(Pair())) as core:
        state = core.reset(np.random.default_rng(plan.seed))
        steps = [core.step(action.ravel()) for action in actions]
        assert core.starts().shape == (22,)
    for number in range(2):
        part = slice(10 * number, 10 * number + 10)
        with closing(EpisodeCore(Reach())) as core:
            alone = core.reset(np.random.default_rng(0), state[part][7:])
            np.testing.assert_array_equal(alone, state[part])
            for action, step in zip(actions, steps, strict=True):
                own = core.step(action[number])
                np.testing.assert_array_equal(own.state, step.state[part])
                assert own.info["base_jerk_rms"] <= step.info["base_jerk_rms"]
                assert own.info["zmp_margin"] >= step.info["zmp_margin"]
                assert own.info["qp_failures"] <= step.info["qp_failures"]


def test_both_have_to_reach_for_the_episode_to_end() -> None:
    near = LAYOUT.columns(*LAYOUT.compared)
    with closing(EpisodeCore(Pair())) as core:
        hands = core.reset(np.random.default_rng(0))[near]
        far = hands + np.array([0.5, 0.0, 0.0])
        still = np.array([0.0, 0.0, 0.0, 1.0] * 2)
        for goals, ends in (((hands, far), False), ((hands, hands), True)):
            core.reset(np.random.default_rng(0), np.concatenate(goals))
            step = core.step(still)
            assert (step.terminated, step.info["is_success"]) == (ends, ends)


@pytest.mark.slow
def test_four_agents_of_two_robots_go_through_everything(
    datasets_home: Path, tmp_path: Path
) -> None:
    """Collected, checked, learnt from, evaluated, exported."""
    data, run = str(tmp_path / "pair-v0"), tmp_path / "run"
    collect = ["collect", "scripted", "--task", "Pair-v0", "--steps", "10"]
    assert main([*collect, "--dataset", data, "--workers", "1"]) == 0
    assert main(["datasets", "show", data]) == 0
    assert main(["datasets", "verify", data, "--replay"]) == 0
    episode = load_dataset(data).episodes[0]
    assert episode.success and episode.start.shape == (22,)
    assert episode.direction is None
    words = ["train", "matd3-bc", "--dataset", data, "--updates", "10", "--hidden", "8"]
    few = ["--eval-episodes", "2", "--curve-episodes", "1", "--max-steps", "2"]
    assert main([*words, *few, "--workers", "1", "--out", str(run)]) == 0
    assert main(["eval", str(run / "0"), "--episodes", "2", "--max-steps", "2",
                 "--workers", "1"]) == 0  # fmt: skip
    assert main(["export", str(run / "0"), "--agent", "right_balance"]) == 0


def test_films_show_all_robots() -> None:
    camera = Camera(64, 48)
    task = Pair(max_steps=1, ticks_per_step=24)
    policy = PdPolicy(PdConfig())
    policy.begin = lambda rng, layout: None  # type: ignore[method-assign]
    policy.act = lambda state: np.zeros(8, np.float32)  # type: ignore[method-assign]
    _, frames = film_episode(task, policy, EpisodePlan(0, 1), camera, fps=20)
    assert {frame.shape for frame in frames} == {(48, 128, 3)}
    assert len(frames) == 3  # of 0.1 s: a robot's tick is not counted twice


def test_terms_of_every_tick_end_an_episode() -> None:
    """The peak is that of all 240 ticks, and a user's watch sees them as well."""
    ticks: list[Tick] = []
    with closing(EpisodeCore(Quiet(most=0.05))) as core:
        core.reset(np.random.default_rng(0))
        step = core.step(np.array([-1.0, 0.0, 0.0, 0.0]), ticks.append)
    peak = max(abs(tick.command.acceleration[0]) for tick in ticks)
    assert step.info["peak"] == peak and len(ticks) == 240
    assert step.terminated and step.info["reason"] == "too fast"
    assert not step.info["is_success"]


def test_numbers_of_one_robot_are_its_own() -> None:
    with closing(EpisodeCore(Reach())) as core:
        episode = run_episode(core, PdPolicy(PdConfig()), EpisodePlan(0, 3))
        motion = core.drive.follow(
            lambda k, state: core.task.act(core.attempt, dict.fromkeys(  # type: ignore[arg-type]
                LAYOUT.action_names, 0.5))[0].reference_at(k, state),
            core.drive.controller.priorities(0.5), 24, 8,
        )  # fmt: skip
    info = motion_info([motion])
    assert info["tilt"] == motion.tilt and info["base_pitch"] == motion.base_pitch
    assert set(info) <= set(episode.info)


def test_of_several_robots_the_worst_counts_and_failures_add_up() -> None:
    path = np.empty(0)
    calm = Motion(np.zeros(24), path, path, 0.2, 0.01, 0.01, 0.1, 0.001, 1, 2)
    wild = Motion(np.ones(24), path, path, 0.1, 0.03, -0.03, 0.3, 0.004, 3, 4)
    info = motion_info([calm, wild])
    assert (info["zmp_margin"], info["tilt"], info["base_pitch"]) == (0.1, 0.03, -0.03)
    assert (info["wheel_slip"], info["model_ee_error"]) == (0.3, 0.004)
    assert (info["qp_failures"], info["safe_ticks"]) == (4, 6)
    assert info["base_acceleration_rms"] == 1.0
