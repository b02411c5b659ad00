"""What every task keeps to."""

import json
import pickle
import tempfile
import warnings
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from marl_mm.collectors.replay import ReplayPolicy, replay
from marl_mm.contracts.claims import Claim, demand, demand_refused, demand_same
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.parallel import TeamEnv
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.envs.rollout import EpisodePlan, episode_seed, run_episode
from marl_mm.envs.task import ScriptConfig, Task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.eval.goals import goal_set
from marl_mm.layout import Layout
from marl_mm.spaces import state_space

EPISODES = 3
"""Episodes that a claim looks at."""


@dataclass(frozen=True)
class Named:
    """A task in short: few steps, of a tenth of a second where its numbers allow."""

    name: str
    task: Task
    overrides: Mapping[str, Any]
    """Numbers that were replaced."""


def short(name: str) -> Named:
    """A registered task in short."""
    for ticks, steps in ((24, 5), (24, 10), (240, 5)):
        overrides = {"ticks_per_step": ticks, "max_steps": steps}
        try:
            return Named(name, make_task(name, overrides), overrides)
        except UsageError:  # such as a block that is to be held for longer
            continue
    return Named(name, make_task(name), {})


class Dice:
    """Acts at random within bounds; for episodes of any layout.

    Args:
        most: Steps that an episode may have.
    """

    name = "dice"

    def __init__(self, most: int) -> None:
        self._most = most

    def describe(self) -> dict[str, Any]:
        """Nothing to set."""
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers."""
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._left = self._most

    def act(self, state: np.ndarray) -> np.ndarray:
        """Uniform in the action space, while the episode may go on."""
        demand(self._left, f"an episode goes on after {self._most} steps")
        self._left -= 1
        return self._rng.uniform(self._low, self._high).astype(np.float32)


def episodes(named: Named, numbers: range = range(EPISODES)) -> list[Episode]:
    """Random episodes of a task."""
    dice = Dice(named.task.max_steps)
    with closing(EpisodeCore(named.task)) as core:
        plans = [EpisodePlan(i, episode_seed(0, i, "collect")) for i in numbers]
        return [run_episode(core, dice, plan) for plan in plans]


def _layout(named: Named) -> None:
    layout = named.task.layout
    again = Layout.from_json(json.loads(json.dumps(layout.to_json())))
    demand(again == layout, "the layout is another one after a round trip through JSON")
    space = state_space(layout)
    with closing(EpisodeCore(named.task)) as core:
        core.reset(np.random.default_rng(0))
        told = set(named.task.observe(core.attempt))  # type: ignore[arg-type]
        known = {*layout.state_names} - {*layout.desired}
        unknown = told - known
        demand(not unknown, f"observe tells {', '.join(sorted(unknown))}, not in it")
    for state in np.concatenate([one.states for one in episodes(named)]):
        for entry, value in zip(layout.state, state.tolist(), strict=True):
            demand(
                entry.low <= value <= entry.high, f"state entry {entry} is {value:g}"
            )
        demand(space.contains(state), "a state is outside of the state space")


def _seeds(named: Named) -> None:
    one, other = episodes(named), episodes(named)
    alone = [episodes(named, range(i, i + 1))[0] for i in range(1, EPISODES)]
    for a, b in zip([*one, *one[1:]], [*other, *alone], strict=True):
        _same_episode(a, b)
    states = [episode.states[0] for episode in one]
    varied = any(not np.array_equal(states[0], state) for state in states[1:])
    demand(varied, "all seeds begin in the same state, goal included")


def _same_episode(one: Episode, other: Episode) -> None:
    for name in ("states", "actions", "rewards", "terminated", "truncated", "start"):
        demand_same(getattr(one, name), getattr(other, name), name)
    for name, values in one.info.items():
        demand_same(values, other.info[name], f"info {name}")


def _beside(named: Named) -> None:
    """Two at once, step by step in turn."""
    alone = episodes(named, range(2))
    with (
        closing(EpisodeCore(named.task)) as one,
        closing(EpisodeCore(named.task)) as other,
    ):
        pairs = list(zip((one, other), alone, strict=True))
        for core, episode in pairs:
            state = core.reset(seeding.np_random(episode.seed)[0])
            demand_same(state, episode.states[0], "states beside another episode")
        for number in range(max(map(len, alone))):
            for core, episode in pairs:
                if number < len(episode):
                    step = core.step(episode.actions[number])
                    then = episode.states[number + 1]
                    demand_same(step.state, then, "states beside another episode")
                    same = step.reward == episode.rewards[number]
                    demand(same, "rewards differ beside another episode")


def _numbers(named: Named) -> None:
    task = named.task
    unknown = set(task.needs) - {*task.info, *task.layout.state_names}
    demand(not unknown, f"needs {', '.join(unknown)}, which nothing tells")
    for episode in episodes(named):
        for name, values in episode.info.items():
            finite = values.dtype.kind in "fiub" and np.isfinite(values).all()
            demand(finite, f"info {name} is no finite number")


def _highest_return(named: Named) -> None:
    """Returns from any step on are looked at, and rewards of goals that are hit."""
    task = named.task
    bound = task.highest_return
    if bound is None:
        return
    for episode in episodes(named):
        achieved = episode.states[1:, task.layout.achieved]
        terms = arrays_of([episode], "contract").reward_terms(task.needs)
        returns = np.cumsum(episode.rewards[::-1])
        hits = np.asarray(task.judge(achieved, achieved.copy(), terms)[0])
        found = {"reward": episode.rewards, "return": returns, "hit's reward": hits}
        for what, values in found.items():
            highest = values.max()
            demand(highest <= bound, f"a {what} is {highest:g}, the bound {bound:g}")


def _ends(named: Named) -> None:
    for episode in episodes(named):  # which see to their lengths
        ended = episode.terminated | episode.truncated
        demand(ended[-1] and not ended[:-1].any(), "an episode goes on after its end")
        both = (episode.terminated & episode.truncated).any()
        demand(not both, "a step is both terminated and truncated")
        fine = named.task.fails or not episode.failed.any()
        demand(fine, "an episode fails, and fails is not set")
        words = isinstance(episode.reason, str) or not named.task.fails
        demand(words, f"failure tells {episode.reason!r}, expected words")


def _hindsight(named: Named) -> None:
    task, layout = named.task, named.task.layout
    listed = episodes(named)
    arrays = arrays_of(listed, "contract")
    after = arrays.states[~arrays.is_first_state()]
    terms = arrays.reward_terms(task.needs)
    achieved, goals = after[:, layout.achieved], after[:, layout.goal]
    reward, ended = task.judge(achieved, goals, terms)
    demand_same(np.asarray(reward, np.float64), arrays.rewards, "rewards")
    demand_same(np.asarray(ended, bool), arrays.terminated, "terminations")
    moved = goals + 10.0
    far, _ = task.judge(achieved, moved, terms)
    demand(np.shape(far) == (len(goals),), "rewards of other goals have another shape")
    hit, done = task.judge(achieved, achieved.copy(), terms)
    better = (np.asarray(hit) >= np.asarray(far)).all()
    demand(better, "a goal that was hit is worth less than one 10 off")
    demand(np.shape(done) == (len(goals),), "terminations have another shape")
    for episode in listed:
        _come_to(named, episode)


def _come_to(named: Named, episode: Episode) -> None:
    """Once more, for the goal that it came to: what hindsight says of it happens."""
    task, layout = named.task, named.task.layout
    goal = episode.states[-1, layout.achieved]
    plan = EpisodePlan(episode.index, episode.seed, tuple(goal.tolist()))
    with closing(EpisodeCore(task)) as core:
        again = run_episode(core, ReplayPolicy(episode), plan)
    steps = min(len(again), len(episode))
    now, then = (
        one.states[: steps + 1, layout.observation] for one in (again, episode)
    )
    demand_same(now, then, "states with another goal")
    achieved = episode.states[1:, layout.achieved]
    terms = arrays_of([episode], "contract").reward_terms(task.needs)
    reward, ended = task.judge(achieved, np.tile(goal, (len(achieved), 1)), terms)
    said = np.asarray(reward, np.float64)[:steps]
    demand_same(said, again.rewards[:steps], "rewards for a goal that it came to")
    said = np.asarray(ended, bool)[:steps]
    demand_same(said, again.terminated[:steps], "ends at a goal that it came to")


def _replay(named: Named) -> None:
    with tempfile.TemporaryDirectory() as folder:
        location = locate(str(Path(folder, "contract-v0")))
        arrays = arrays_of(episodes(named), location.id)
        provenance = Provenance(
            task=named.name, overrides=named.overrides, collector="dice", seed=0
        )
        write_dataset(location, arrays, provenance)
        problems = verify(location)
        demand(not problems, "; ".join(problems))
        different = [one for one in replay(load_dataset(location)) if one is not None]
        demand(not different, "; ".join(different[:1]))


def _goals(named: Named) -> None:
    few, many = (goal_set(named.task, count, 0) for count in (2, 4))
    demand(many[:2] == few, "the first goals of a seed depend on how many there are")
    place = named.task.layout.goal
    with closing(EpisodeCore(named.task)) as core:
        for plan in few:
            drawn = core.reset(np.random.default_rng(plan.seed))[place]
            goal = np.array(drawn if plan.goal is None else plan.goal, np.float64)
            state = core.reset(np.random.default_rng(0), goal.copy())
            demand_same(state[place], goal, "given goals")
        shape = np.zeros(len(goal) + 1)
        rng = np.random.default_rng(0)
        demand_refused(lambda: core.reset(rng, shape), "a goal that is too wide")


def _actions(named: Named) -> None:
    layout = named.task.layout
    with closing(EpisodeCore(named.task)) as core:
        for bound in (layout.low, layout.high):
            core.reset(np.random.default_rng(0))
            core.step(np.array(bound))
        core.reset(np.random.default_rng(0))
        bad = np.full(len(layout.action), np.nan)
        demand_refused(lambda: core.step(bad), "an action of NaN")
        wide = np.zeros(len(layout.action) + 1)
        demand_refused(lambda: core.step(wide), "an action that is too wide")


def _expert(named: Named) -> None:
    """A task may do without one; a script that there is sets what there is to set."""
    layout, script = named.task.layout, ScriptConfig()
    for state in np.concatenate([one.states for one in episodes(named)]):
        seen = dict(zip(layout.state_names, state.tolist(), strict=True))
        try:
            action = named.task.expert(seen, script)
        except UsageError:
            return
        differ = set(action) ^ set(layout.action_names)
        demand(not differ, f"the expert sets {', '.join(action)}: {', '.join(differ)}")
        for entry in layout.action:
            value = action[entry.name]
            inside = entry.low <= value <= entry.high
            demand(inside, f"the expert sets {entry} to {value}")
        again = named.task.expert(seen, script)
        demand(again == action, "the expert acts otherwise in the same state")


def _workers(named: Named) -> None:
    again = pickle.loads(pickle.dumps(named.task))
    demand(again == named.task, "the task is another one after pickling")
    numbers = json.loads(json.dumps(config_dict(named.task), allow_nan=False))
    made = make_task(named.name, numbers)
    demand(made == named.task, "the task is another one when made of its numbers")
    longer = replace(named.task, max_steps=named.task.max_steps + 1)
    demand(longer != named.task, "numbers do not count in comparisons")


def _pettingzoo(named: Named) -> None:
    def make() -> TeamEnv:
        return TeamEnv(named.name, named.overrides)

    env = make()
    with closing(env), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parallel_api_test(env, num_cycles=3)
        parallel_seed_test(make, num_cycles=3)


def _gymnasium(named: Named) -> None:
    env = gymnasium.make(
        f"marl_mm/{named.name}",
        overrides=dict(named.overrides),
        disable_env_checker=True,
    )
    with closing(env), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env.unwrapped, skip_render_check=True)
        _judges(env.unwrapped)


def _judges(env: Any) -> None:
    """What others' replays ask of a goal environment."""
    env.reset(seed=0)
    observation, reward, terminated, _, info = env.step(env.action_space.high)
    goals = observation["achieved_goal"], observation["desired_goal"]
    for ask, said in (
        (env.compute_reward, reward),
        (env.compute_terminated, terminated),
    ):
        demand(
            ask(*goals, info) == said, f"{ask.__name__} says otherwise than the step"
        )


_CLAIMS: dict[str, Claim] = {
    "its layout is complete, and states are within it": _layout,
    "episodes follow from their seeds to the bit": _seeds,
    "an episode keeps nothing on the task": _beside,
    "its step numbers are finite": _numbers,
    "no return passes its highest": _highest_return,
    "episodes end once, and in time": _ends,
    "rewards in hindsight are those online to the bit": _hindsight,
    "a dataset of it passes verify, and replays to the bit": _replay,
    "goals of evaluations are its own": _goals,
    "actions at their bounds work, and those that make no sense are refused": _actions,
    "its expert sets every entry within its bounds, by the state alone": _expert,
    "it travels to workers and into records": _workers,
    "PettingZoo's own tests pass": _pettingzoo,
    "Gymnasium's own test passes": _gymnasium,
}


def task_claims(named: Named) -> dict[str, Claim]:
    """Claims about a task, by their words."""
    return _CLAIMS
