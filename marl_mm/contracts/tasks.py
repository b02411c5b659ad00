"""Claims that hold of every task."""

import json
import pickle
import tempfile
import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from marl_mm.collectors.replay import ReplayPolicy, replay
from marl_mm.contracts.claims import Claim, demand, demand_refused, demand_same
from marl_mm.contracts.episodes import EPISODES, ShortTask, episodes
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.parallel import TeamEnv
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import ScriptConfig, Task
from marl_mm.episode import Episode
from marl_mm.eval.goals import goal_set
from marl_mm.layout import Layout
from marl_mm.spaces import state_space


def _layout(short: ShortTask) -> None:
    layout = short.task.layout
    again = Layout.from_json(json.loads(json.dumps(layout.to_json())))
    demand(again == layout, "the layout is another one after a round trip through JSON")
    space = state_space(layout)
    with closing(EpisodeCore(short.task)) as core:
        core.reset(np.random.default_rng(0))
        seen = set(short.task.observe(core.attempt))  # type: ignore[arg-type]
        expected = {*layout.state_names} - {*layout.desired}
        unknown = seen - expected
        demand(not unknown, f"observe tells {', '.join(sorted(unknown))}, not in it")
    for state in np.concatenate([episode.states for episode in short.episodes]):
        for entry, value in zip(layout.state, state.tolist(), strict=True):
            demand(
                entry.low <= value <= entry.high, f"state entry {entry} is {value:g}"
            )
        demand(space.contains(state), "a state is outside of the state space")


def _seeds(short: ShortTask) -> None:
    first, again = episodes(short), episodes(short)
    alone = [episodes(short, range(i, i + 1))[0] for i in range(1, EPISODES)]
    for here, there in zip([*first, *first[1:]], [*again, *alone], strict=True):
        _same_episode(here, there)
    states = [episode.states[0] for episode in first]
    varied = any(not np.array_equal(states[0], state) for state in states[1:])
    demand(varied, "all seeds begin in the same state, goal included")


def _same_episode(here: Episode, there: Episode) -> None:
    for name in ("states", "actions", "rewards", "terminated", "truncated", "start"):
        demand_same(getattr(here, name), getattr(there, name), name)
    for name, values in here.info.items():
        demand_same(values, there.info[name], f"info {name}")


def _beside(short: ShortTask) -> None:
    """Two episodes at once, which take their steps in turn."""
    alone = short.episodes[:2]
    with (
        closing(EpisodeCore(short.task)) as first,
        closing(EpisodeCore(short.task)) as second,
    ):
        pairs = list(zip((first, second), alone, strict=True))
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


def _numbers(short: ShortTask) -> None:
    task = short.task
    unknown = set(task.needs) - {*task.info, *task.layout.state_names}
    demand(not unknown, f"needs {', '.join(unknown)}, which nothing tells")
    for episode in short.episodes:
        for name, values in episode.info.items():
            demand(np.isfinite(values).all(), f"info {name} is no finite number")


def _highest_return(short: ShortTask) -> None:
    """Checks the returns from every step on, and the rewards of goals that are hit."""
    task = short.task
    bound = task.highest_return
    if bound is None:
        return
    for episode in short.episodes:
        achieved = episode.states[1:, task.layout.achieved]
        terms = arrays_of([episode], "contract").reward_terms(task.needs)
        returns = np.cumsum(episode.rewards[::-1])
        hits = np.asarray(task.judge(achieved, achieved.copy(), terms)[0])
        measures = {"reward": episode.rewards, "return": returns, "hit's reward": hits}
        for name, values in measures.items():
            highest = values.max()
            demand(highest <= bound, f"a {name} is {highest:g}, the bound {bound:g}")


def _ends(short: ShortTask) -> None:
    for episode in short.episodes:  # which checks the lengths
        ended = episode.terminated | episode.truncated
        demand(ended[-1] and not ended[:-1].any(), "an episode goes on after its end")
        both = (episode.terminated & episode.truncated).any()
        demand(not both, "a step is both terminated and truncated")


def _hindsight(short: ShortTask) -> None:
    task, layout = short.task, short.task.layout
    listed = short.episodes
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
        _come_to(short, episode)


def _come_to(short: ShortTask, episode: Episode) -> None:
    """Repeats an episode for the goal that it came to: hindsight has foretold it."""
    task, layout = short.task, short.task.layout
    goal = episode.states[-1, layout.achieved]
    plan = EpisodePlan(episode.index, episode.seed, tuple(goal.tolist()))
    with closing(EpisodeCore(task)) as core:
        again = run_episode(core, ReplayPolicy(episode), plan)
    steps = min(len(again), len(episode))
    now, then = (
        run.states[: steps + 1, layout.observation] for run in (again, episode)
    )
    demand_same(now, then, "states with another goal")
    achieved = episode.states[1:, layout.achieved]
    terms = arrays_of([episode], "contract").reward_terms(task.needs)
    reward, ended = task.judge(achieved, np.tile(goal, (len(achieved), 1)), terms)
    said = np.asarray(reward, np.float64)[:steps]
    demand_same(said, again.rewards[:steps], "rewards for a goal that it came to")
    said = np.asarray(ended, bool)[:steps]
    demand_same(said, again.terminated[:steps], "ends at a goal that it came to")


def _replay(short: ShortTask) -> None:
    with tempfile.TemporaryDirectory() as folder:
        location = locate(str(Path(folder, "contract-v0")))
        arrays = arrays_of(short.episodes, location.id)
        provenance = Provenance(
            task=short.name, overrides=short.overrides, collector="dice", seed=0
        )
        write_dataset(location, arrays, provenance)
        problems = verify(location)
        demand(not problems, "; ".join(problems))
        changes = [text for text in replay(load_dataset(location)) if text is not None]
        demand(not changes, "; ".join(changes[:1]))


def _goals(short: ShortTask) -> None:
    few, many = (goal_set(short.task, count, 0) for count in (2, 4))
    demand(many[:2] == few, "the first goals of a seed depend on how many there are")
    place = short.task.layout.goal
    with closing(EpisodeCore(short.task)) as core:
        for plan in few:
            drawn = core.reset(np.random.default_rng(plan.seed))[place]
            goal = np.array(drawn if plan.goal is None else plan.goal, np.float64)
            state = core.reset(np.random.default_rng(0), goal.copy())
            demand_same(state[place], goal, "given goals")
        shape = np.zeros(len(goal) + 1)
        rng = np.random.default_rng(0)
        demand_refused(lambda: core.reset(rng, shape), "a goal that is too wide")


def _actions(short: ShortTask) -> None:
    layout = short.task.layout
    with closing(EpisodeCore(short.task)) as core:
        for bound in (layout.low, layout.high):
            core.reset(np.random.default_rng(0))
            core.step(np.array(bound))
        core.reset(np.random.default_rng(0))
        bad = np.full(len(layout.action), np.nan)
        demand_refused(lambda: core.step(bad), "an action of NaN")
        wide = np.zeros(len(layout.action) + 1)
        demand_refused(lambda: core.step(wide), "an action that is too wide")


def _expert(short: ShortTask) -> None:
    """A task may have no script; one that it has sets every entry of the action."""
    layout, script = short.task.layout, ScriptConfig()
    if type(short.task).expert is Task.expert:
        return
    for state in np.concatenate([episode.states for episode in short.episodes]):
        seen = dict(zip(layout.state_names, state.tolist(), strict=True))
        action = short.task.expert(seen, script)
        differ = set(action) ^ set(layout.action_names)
        demand(not differ, f"the expert sets {', '.join(action)}: {', '.join(differ)}")
        for entry in layout.action:
            value = action[entry.name]
            inside = entry.low <= value <= entry.high
            demand(inside, f"the expert sets {entry} to {value}")
        again = short.task.expert(seen, script)
        demand(again == action, "the expert acts otherwise in the same state")


def _workers(short: ShortTask) -> None:
    again = pickle.loads(pickle.dumps(short.task))
    demand(again == short.task, "the task is another one after pickling")
    numbers = json.loads(json.dumps(config_dict(short.task), allow_nan=False))
    made = make_task(short.name, numbers)
    demand(made == short.task, "the task is another one when made of its numbers")
    longer = replace(short.task, max_steps=short.task.max_steps + 1)
    demand(longer != short.task, "numbers do not count in comparisons")


def _pettingzoo(short: ShortTask) -> None:
    def make() -> TeamEnv:
        return TeamEnv(short.name, short.overrides)

    env = make()
    with closing(env), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parallel_api_test(env, num_cycles=3)
        parallel_seed_test(make, num_cycles=3)


def _gymnasium(short: ShortTask) -> None:
    env = gymnasium.make(
        f"marl_mm/{short.name}",
        overrides=dict(short.overrides),
        disable_env_checker=True,
    )
    with closing(env), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env.unwrapped, skip_render_check=True)
        _judges(env.unwrapped)


def _judges(env: Any) -> None:
    """Rewards and ends in hindsight, as other libraries' replay buffers ask."""
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
    "its expert, if any, sets every entry within bounds, by the state alone": _expert,
    "it travels to workers and into records": _workers,
    "PettingZoo's own tests pass": _pettingzoo,
    "Gymnasium's own test passes": _gymnasium,
}


def task_claims(short: ShortTask) -> dict[str, Claim]:
    """Claims about a task, by their texts."""
    return _CLAIMS
