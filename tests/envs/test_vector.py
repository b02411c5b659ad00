"""Vector environments: the numbers of single ones, and what ends or breaks them."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import marl_mm
from marl_mm import interrupts
from marl_mm.envs import parallel_env, registry, vector
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.order import Order
from marl_mm.envs.slots import Backend, Slot
from marl_mm.envs.task import Attempt, Values
from marl_mm.envs.tasks.reach import Reach
from marl_mm.errors import (
    InvalidActionError,
    MarlMmError,
    NonFiniteStateError,
    UsageError,
    WorkerDiedError,
)

SHORT = {"ticks_per_step": 24, "max_steps": 3}
PLACES = [("mujoco", "threads"), ("mujoco", "processes"), ("bullet", "processes")]
MIDDLE = np.array([0.0, 0.0, 0.0, 0.5])


def options(engine: str, **more: Any) -> dict[str, Any]:
    return {"simulation": {"engine": engine}, **SHORT, **more}


def opened(n: int = 3, workers: int = 2, engine: str = "bullet", **more: Any) -> Any:
    return marl_mm.make_vec("Reach-v0", n, workers, options(engine), **more)


def team_of(n: int, workers: int, engine: str, backend: Any = None) -> Any:
    return marl_mm.parallel_vec(
        "Reach-v0", n, workers, options(engine), backend=backend
    )


def randomly(vector: Any, seed: int = 0) -> Iterator[np.ndarray]:
    """Endless actions, float32, of which some are out of bounds."""
    rng = np.random.default_rng(seed)
    low, high = vector.action_space.low, vector.action_space.high
    while True:
        yield rng.uniform(1.1 * low - 0.05, 1.1 * high).astype(np.float32)


def gymnasiums(task: str, n: int, overrides: dict[str, Any]) -> Any:
    return SyncVectorEnv(
        [lambda: GoalEnv(task, overrides)] * n, autoreset_mode=AutoresetMode.SAME_STEP
    )


# --- The numbers -------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize(("engine", "backend"), PLACES)
def test_numbers_and_infos_are_those_of_gymnasiums_own_vector(
    engine: str, backend: Any, workers: int
) -> None:
    """To the last bit, across the ends of episodes, with masks and final infos."""
    alone = gymnasiums("Reach-v0", 4, options(engine))
    vector = opened(4, workers, engine, backend=backend)
    assert vector.observation_space == alone.observation_space
    assert vector.single_observation_space == alone.single_observation_space
    assert vector.action_space == alone.action_space
    assert vector.single_action_space == alone.single_action_space
    assert vector.metadata == alone.metadata
    for seed in (5, [3, None, 1, 2], None):
        expected, given = alone.reset(seed=seed), vector.reset(seed=seed)
        assert data_equivalence(expected, given, exact=True)
        assert vector.np_random_seed == alone.np_random_seed
        for _, actions in zip(range(5), randomly(vector), strict=False):
            expected, given = alone.step(actions), vector.step(actions)
            assert data_equivalence(expected, given, exact=True)
            assert given[0] in vector.observation_space
    alone.close()
    vector.close()


@pytest.mark.slow
def test_whole_steps_and_tasks_that_fail_are_the_same_too() -> None:
    for task, engine in (("Reach-v0", "mujoco"), ("CarryReach-v0", "bullet")):
        overrides = {"simulation": {"engine": engine}, "max_steps": 2}
        alone = gymnasiums(task, 3, overrides)
        vector = marl_mm.make_vec(task, 3, 2, overrides)
        assert data_equivalence(alone.reset(seed=0), vector.reset(seed=0), exact=True)
        for _, actions in zip(range(3), randomly(vector), strict=False):
            expected, given = alone.step(actions), vector.step(actions)
            assert data_equivalence(expected, given, exact=True)
        alone.close()
        vector.close()


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize(("engine", "backend"), PLACES)
def test_arrays_of_agents_are_those_of_single_teams(
    engine: str, backend: Any, workers: int
) -> None:
    team = team_of(4, workers, engine, backend)
    envs: list[Any] = [parallel_env("Reach-v0", options(engine)) for _ in range(4)]
    assert team.possible_agents == envs[0].possible_agents
    rows, infos = team.reset(seed=7)
    alone = [env.reset(seed=7 + i)[0] for i, env in enumerate(envs)]
    assert infos == {agent: {} for agent in team.agents}
    rng = np.random.default_rng(0)
    for _ in range(5):
        for agent in team.agents:
            assert (
                rows[agent].tobytes() == np.stack([o[agent] for o in alone]).tobytes()
            )
            assert rows[agent] in team.observation_space(agent)
            assert rows[agent][0] in team.single_observation_space(agent)
            single = team.single_action_space(agent).shape
            assert team.action_space(agent).shape == (4, *single)
        states = np.stack([env.state() for env in envs])
        assert team.state().tobytes() == states.tobytes()
        actions = {
            agent: rng.uniform(space.low, space.high).astype(np.float32)
            for agent, space in team.action_spaces.items()
        }
        rows, *numbers, infos = team.step(actions)
        for i, env in enumerate(envs):
            seen, *values, told = env.step({a: v[i] for a, v in actions.items()})
            alone[i] = seen
            ended = not env.agents
            if ended:
                alone[i], _ = env.reset()
            for agent in team.agents:
                given = [float(number[agent][i]) for number in numbers]
                assert given == [float(value[agent]) for value in values]
                info = infos[agent]
                if ended:
                    assert info["_final_obs"][i] and info["_final_info"][i]
                    assert (info["final_obs"][i] == seen[agent]).all()
                    info = info["final_info"]
                else:
                    assert "final_obs" not in info or info["final_obs"][i] is None
                for key, value in told[agent].items():
                    assert info[f"_{key}"][i] and info[key][i] == value
    for env in (team, *envs):
        env.close()


# --- Gymnasium's contract ----------------------------------------------------


def test_it_is_a_vector_environment_for_gymnasiums_wrappers() -> None:
    vector = opened(3, engine="mujoco")
    assert isinstance(vector, VectorEnv) and vector.unwrapped is vector
    assert vector.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    counted: Any = RecordEpisodeStatistics(vector)
    counted.reset(seed=0)
    assert counted.np_random_seed == (0, 1, 2)
    returns = np.zeros(3)
    for _ in range(3):
        _, rewards, _, truncated, infos = counted.step(np.tile(MIDDLE, (3, 1)))
        returns += rewards
    assert truncated.all() and infos["_episode"].all()
    assert (infos["episode"]["r"] == returns).all()
    counted.close()
    assert vector.closed


def test_seeds_that_are_not_given_differ() -> None:
    vector = opened(3, engine="mujoco")
    assert vector.np_random_seed == (None, None, None)
    vector.reset()
    first = vector.np_random_seed
    assert len(set(first)) == 3
    vector.reset()
    assert vector.np_random_seed == first
    vector.close()


def test_a_mask_tells_which_environments_begin_and_a_goal_is_of_all() -> None:
    vector = opened(3)
    with pytest.raises(UsageError, match=r"step\(\) was called before reset\(\)"):
        vector.step(np.tile(MIDDLE, (3, 1)))
    vector.reset(seed=7, options={"reset_mask": np.array([True, False, True])})
    assert vector.np_random_seed == (7, None, 9)
    with pytest.raises(UsageError, match=r"state\(\) was called before reset\(\)"):
        vector.state()
    before, _ = vector.reset(seed=0)
    moved, *_ = vector.step(np.tile(MIDDLE, (3, 1)))
    mask = np.array([False, True, False])
    goal = (0.9, 0.1, 0.6)
    after, _ = vector.reset(seed=0, options={"reset_mask": mask, "goal": goal})
    same = (after["observation"] == moved["observation"]).all(1)
    assert same.tolist() == [True, False, True]
    assert (after["desired_goal"][1] == goal).all()
    assert (after["desired_goal"][0] == before["desired_goal"][0]).all()
    vector.close()


def test_what_it_returns_is_the_callers() -> None:
    vector = opened(2)
    first, _ = vector.reset(seed=0)
    kept = {key: value.copy() for key, value in first.items()}
    vector.step(np.tile(MIDDLE, (2, 1)))
    assert data_equivalence(first, kept, exact=True)
    team = team_of(2, 1, "mujoco")
    with pytest.raises(UsageError, match=r"state\(\) was called before reset\(\)"):
        team.state()
    rows, _ = team.reset(seed=0)
    before = {agent: value.copy() for agent, value in rows.items()}
    team.state()[:] = 0.0
    assert team.state().any(axis=1).all()
    team.step({a: np.zeros(s.shape) for a, s in team.action_spaces.items()})
    assert data_equivalence(rows, before, exact=True)
    team.close()
    vector.close()


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_pictures_are_of_every_environment(engine: str) -> None:
    camera = GoalEnv("Reach-v0").task.camera
    vector = opened(3, engine=engine, render_mode="rgb_array")
    vector.reset(seed=0)
    pictures = vector.render()
    assert [p.shape for p in pictures] == [(camera.height, camera.width, 3)] * 3
    assert (pictures[0] != pictures[1]).any()  # goals
    vector.close()
    blind = opened(2, engine=engine)
    assert blind.render() is None
    blind.close()


# --- Bad input ---------------------------------------------------------------

WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no environment": ({"n": 0}, "n is 0, expected an integer >= 1"),
    "a truth value": ({"n": True}, "n is True, expected an integer >= 1"),
    "half of one": ({"n": 1.5}, "n is 1.5, expected an integer >= 1"),
    "no worker": ({"workers": 0}, "workers is 0, expected an integer >= 1"),
    "many workers": ({"n": 70, "workers": 70}, "workers is 70, expected 1 to 64"),
    "a task": ({"task": "Reech-v0"}, "unknown task 'Reech-v0'"),
    "an engine": ({"overrides": options("ode")}, "engine is 'ode', expected bullet or"),
    "a field": ({"overrides": {"steps": 3}}, "unknown field 'steps'"),
    "a mode": ({"render_mode": "human"}, "render_mode is 'human', expected rgb_array"),
    "a backend": ({"backend": "gpu"}, "backend is 'gpu', expected threads or"),
    "threads of PyBullet": (
        {"backend": "threads", "overrides": {"simulation": {"engine": "bullet"}}},
        "runs in one thread only",
    ),
    "threads that render": (
        {
            "backend": "threads",
            "render_mode": "rgb_array",
            "overrides": options("mujoco"),
        },
        "runs in one thread only",
    ),
}


@pytest.mark.parametrize("case", WRONG)
@pytest.mark.parametrize("make", [marl_mm.make_vec, marl_mm.parallel_vec])
def test_arguments_that_make_no_sense_are_told(make: Any, case: str) -> None:
    arguments, message = WRONG[case]
    with pytest.raises(UsageError, match=message):
        make(**{"task": "Reach-v0", "n": 2, "workers": 2, **arguments})
    assert not workers()


ACTIONS: list[tuple[Any, str]] = [
    (MIDDLE, r"actions have shape \(4,\), expected \(3, 4\)"),
    (np.tile(MIDDLE, (2, 1)), r"actions have shape \(2, 4\), expected \(3, 4\)"),
    (np.array([MIDDLE, MIDDLE * np.nan, MIDDLE]), "action of environment 1 is .nan"),
    (np.full((3, 4), np.inf), "action of environment 0 is .inf"),
    ("left", "actions are 'left', expected numbers"),
    (None, r"actions have shape \(\)"),
]


@pytest.mark.slow
def test_wrong_actions_are_told_before_any_environment_acts() -> None:
    vector = opened(3)
    reference = opened(3)
    for each in (vector, reference):
        each.reset(seed=0)
    for actions, message in ACTIONS:
        with pytest.raises(InvalidActionError, match=message):
            vector.step(actions)
    right = np.tile(MIDDLE, (3, 1))
    assert data_equivalence(vector.step(right), reference.step(right), exact=True)
    for seed in (-1, "one", [1, 2], [1, 2, -3], 1.5):
        with pytest.raises(UsageError, match=r"seed is .*, expected an integer >= 0"):
            vector.reset(seed=seed)
    for mask in ([True], [False] * 3, [1, 0, 1]):
        with pytest.raises(UsageError, match=r"reset_mask is .*, expected 3 truth"):
            vector.reset(options={"reset_mask": np.array(mask)})
    with pytest.raises(UsageError, match=r"goal is .*, expected 3 finite numbers"):
        vector.reset(seed=7, options={"goal": (1, 2)})
    with pytest.raises(UsageError, match=r"no option 'gaol' \(did you mean goal\?\)"):
        vector.reset(seed=7, options={"gaol": (1, 2, 3)})
    # Episodes go on, and so do the streams of those that follow.
    assert data_equivalence(vector.step(right), reference.step(right), exact=True)
    assert data_equivalence(vector.reset(), reference.reset(), exact=True)
    for each in (vector, reference):
        each.close()
        each.close()


def test_a_vector_that_was_refused_is_closed_in_silence() -> None:
    """Gymnasium 1.1 does so where nothing refers to it any more."""
    vector.GoalVector.__new__(vector.GoalVector).close()


def test_resetting_some_is_no_reset_of_all() -> None:
    """The one that has begun does not act until all have."""
    vector, reference = opened(3), opened(3)
    right, first = np.tile(MIDDLE, (3, 1)), np.array([True, False, False])
    vector.reset(seed=0, options={"reset_mask": first})
    with pytest.raises(UsageError, match=r"step\(\) was called before reset"):
        vector.step(right)
    vector.reset(seed=0, options={"reset_mask": ~first})
    reference.reset(seed=0)
    assert data_equivalence(vector.step(right), reference.step(right), exact=True)
    vector.close()
    reference.close()


def test_wrong_actions_of_agents_are_told() -> None:
    team = team_of(2, 1, "mujoco")
    team.reset(seed=0)
    right = {a: np.zeros(s.shape) for a, s in team.action_spaces.items()}
    first, last = team.agents[0], team.agents[-1]
    for wrong, message in (
        ({first: right[first]}, f"no action for agent '{last}'"),
        ({**right, first: np.zeros(3)}, rf"'{first}' has shape \(3,\), expected \(2, "),
        ({**right, last: "up"}, f"'{last}' is 'up', expected numbers"),
        ({**right, last: right[last] + np.nan}, "of environment 0 .* finite numbers"),
    ):
        with pytest.raises(InvalidActionError, match=message):
            team.step(wrong)
    team.step(right)
    team.close()


@pytest.mark.bullet
def test_a_task_that_stays_in_this_process_is_told(registries: None) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Local(Reach):
        pass

    registry.register_task("Local-v0", Local())
    with pytest.raises(UsageError, match="Local cannot be sent to another process"):
        marl_mm.make_vec("Local-v0", 2, 2)
    vector = marl_mm.make_vec("Local-v0", 2, 1, SHORT)
    vector.reset(seed=0)
    vector.close()


def test_an_environment_that_fails_leaves_the_others_and_a_reset_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    vector, reference = opened(3, engine="mujoco"), opened(3, engine="mujoco")
    vector.reset(seed=0)
    count = iter(range(3))

    def fails(self: EpisodeCore, *arguments: Any) -> Any:
        if next(count) == 1:
            raise NonFiniteStateError("q is nan")
        return step(self, *arguments)

    step = EpisodeCore.step
    with monkeypatch.context() as patched:
        patched.setattr(EpisodeCore, "step", fails)
        with pytest.raises(NonFiniteStateError, match="q is nan"):
            vector.step(np.tile(MIDDLE, (3, 1)))
    with pytest.raises(UsageError, match=r"step\(\) was called before reset\(\)"):
        vector.step(np.tile(MIDDLE, (3, 1)))
    both = vector.reset(seed=1), reference.reset(seed=1)
    assert data_equivalence(*both, exact=True)
    vector.close()
    reference.close()


@dataclass(frozen=True, kw_only=True)
class Fragile(Reach):
    """It fails where alpha is 0; an episode has one step."""

    max_steps: int = 1

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        if action["alpha"] == 0.0:
            raise MarlMmError("no alpha")
        return super().act(attempt, action)


@pytest.mark.slow
def test_after_an_error_streams_go_on_alike_wherever_environments_are(
    registries: None,
) -> None:
    registry.register_task("Fragile-v0", Fragile())
    actions = np.tile(MIDDLE, (3, 1))
    actions[0, 3] = 0.0
    begun = []
    places: list[tuple[int, Backend | None]]
    places = [(1, None), (2, "threads"), (2, "processes")]
    for workers, backend in places:
        mujoco = options("mujoco")
        vector = marl_mm.make_vec("Fragile-v0", 3, workers, mujoco, None, backend)
        vector.reset(seed=0)
        with pytest.raises(MarlMmError, match="no alpha"):
            vector.step(actions)
        observations, _ = vector.reset()
        begun.append(observations["desired_goal"].tolist())
        vector.close()
    assert begun[0] == begun[1] == begun[2]


# --- Ends --------------------------------------------------------------------


def workers() -> list[psutil.Process]:
    """Processes that the fork server has made for this one."""
    me = psutil.Process()
    return [child for child in me.children(recursive=True) if child.ppid() != me.pid]


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "backend"), PLACES)
def test_closing_twice_is_harmless_and_leaves_nothing(
    engine: str, backend: Any
) -> None:
    left = []
    for _ in range(3):
        vector = opened(3, engine=engine, backend=backend)
        vector.reset(seed=0)
        vector.step(np.tile(MIDDLE, (3, 1)))
        vector.close()
        vector.close()
        left.append((psutil.Process().num_fds(), threading.active_count()))
    assert left[2] == left[0] and not workers()
    for call, arguments in (
        (vector.reset, ()),
        (vector.step, (np.tile(MIDDLE, (3, 1)),)),
        (vector.render, ()),
    ):
        with pytest.raises(UsageError, match="the environment is closed"):
            call(*arguments)


def test_a_killed_worker_is_told_and_the_others_end() -> None:
    vector = opened(4)
    vector.reset(seed=0)
    before = workers()
    assert len(before) == 2
    before[0].kill()
    with pytest.raises(WorkerDiedError, match="a worker process died"):
        for _ in range(3):
            vector.step(np.tile(MIDDLE, (4, 1)))
    psutil.wait_procs(before, timeout=10)
    assert vector.closed and not workers()
    with pytest.raises(UsageError, match="the environment is closed"):
        vector.step(np.tile(MIDDLE, (4, 1)))


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "backend"), PLACES)
def test_an_interrupt_waits_for_the_step_and_a_reset_goes_on(
    monkeypatch: pytest.MonkeyPatch, engine: str, backend: Any
) -> None:
    monkeypatch.setattr(interrupts, "_heard", float("-inf"))  # else it is an echo
    vector, reference = (opened(3, 2, engine, backend=backend) for _ in range(2))
    vector.reset(seed=0)
    timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        while True:
            vector.step(np.tile(MIDDLE, (3, 1)))
    assert data_equivalence(vector.reset(seed=2), reference.reset(seed=2), exact=True)
    right = np.tile(MIDDLE, (3, 1))
    assert data_equivalence(vector.step(right), reference.step(right), exact=True)
    vector.close()
    reference.close()


@pytest.mark.slow
@pytest.mark.bullet
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_of_a_script_that_is_stopped(tmp_path: Path, kind: int) -> None:
    script = tmp_path / "mine.py"
    body = """
        import marl_mm
        if __name__ == "__main__":
            vector = marl_mm.make_vec("Reach-v0", 3, 2, {"ticks_per_step": 24})
            vector.reset(seed=0)
            print("begun", flush=True)
            while True:
                vector.step(vector.action_space.sample())
    """
    script.write_text(textwrap.dedent(body))
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    family = psutil.Process(process.pid).children(recursive=True)
    assert len(family) >= 3
    os.killpg(process.pid, kind) if kind == signal.SIGINT else process.kill()
    _, errors = process.communicate(timeout=30)
    assert kind == signal.SIGKILL or errors.strip().endswith("KeyboardInterrupt")
    assert "Process " not in errors, errors
    _, alive = psutil.wait_procs(family, timeout=10)
    assert not alive


def test_a_vector_that_nothing_refers_to_ends() -> None:
    vector = opened(3)
    vector.reset(seed=0)
    before = workers()
    assert before
    del vector
    _, alive = psutil.wait_procs(before, timeout=10)
    assert not alive


def test_a_slot_goes_on_with_its_stream_of_random_numbers() -> None:
    states = np.zeros((2, len(Reach.layout.state)))
    task = registry.make_task("Reach-v0", options("mujoco"))
    slots = [Slot(task, False, state) for state in states]
    for slot in slots:
        slot.reset(3, None)
        slot.reset(None, None)
    assert (states[0] == states[1]).all()
    slots[0].reset(3, None)
    assert (states[0] != states[1]).any()
    for slot in slots:
        slot.close()
