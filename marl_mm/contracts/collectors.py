"""What every collector keeps to."""

import json
import tempfile
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.collectors.replay import replay
from marl_mm.contracts.claims import Claim, demand, demand_same
from marl_mm.contracts.tasks import EPISODES, short
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed, run_episode
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.policy import Policy

LONG = 12
"""Steps of an episode in which a collector is looked at."""

ASKED = 4
"""How often it is asked whether it keeps an episode, and one that was read again."""


@dataclass(frozen=True)
class Named:
    """A collector, and the task that it is looked at in."""

    name: str
    collector: Collector
    task_name: str
    task: Task

    @property
    def overrides(self) -> dict[str, int]:
        """Numbers of the task that were replaced."""
        own = self.task
        return {"ticks_per_step": own.ticks_per_step, "max_steps": own.max_steps}

    def policy(self) -> Policy:
        """The policy of the default settings."""
        policy: Policy = self.collector.policy(self.collector.config(), self.task)
        return policy


def named(name: str, task: str = DEFAULT) -> Named:
    """A registered collector, in a registered task."""
    ticks = short(task).task.ticks_per_step
    own = make_task(task, {"ticks_per_step": ticks, "max_steps": LONG})
    return Named(name, COLLECTORS.get(name), task, own)


def _plans(numbers: range = range(EPISODES)) -> list[EpisodePlan]:
    return [EpisodePlan(i, episode_seed(0, i, "collect")) for i in numbers]


def _episodes(one: Named, plans: list[EpisodePlan]) -> list[Episode]:
    policy = one.policy()
    with closing(EpisodeCore(one.task)) as core:
        return [run_episode(core, policy, plan) for plan in plans]


def _same(one: Episode, other: Episode, what: str) -> None:
    for name in ("states", "actions", "rewards", "terminated", "truncated"):
        demand_same(getattr(one, name), getattr(other, name), f"{what}: {name}")


def _settings(one: Named) -> None:
    config, policy = one.collector.config(), one.policy()
    how = getattr(config, "__dataclass_params__", None)
    demand(how is not None and how.frozen, "its config is no frozen dataclass")
    json.dumps(asdict(config))
    json.dumps(policy.describe())
    demand(config == one.collector.config(), "two default configs differ")
    demand(policy.name == one.name, f"its policy calls itself {policy.name!r}")


def _acts(one: Named) -> None:
    layout = one.task.layout
    for episode in _episodes(one, _plans()):
        actions = episode.actions
        demand(np.isfinite(actions).all(), "an action is not finite")
        inside = (actions >= layout.low).all() and (actions <= layout.high).all()
        demand(inside, "an action is outside of the action space")
    policy = one.policy()
    with closing(EpisodeCore(one.task)) as core:
        state = core.reset(np.random.default_rng(0))
        policy.begin(np.random.default_rng(0), layout)
        action = policy.act(state.copy())
    right = action.shape == (len(layout.action),) and action.dtype == np.float32
    demand(right, f"an action is {action.dtype} of shape {action.shape}")


def _seeds(one: Named) -> None:
    first, again = (_episodes(one, _plans()) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        _same(a, b, "the same seed")


def _remembers_nothing(one: Named) -> None:
    for number, after in enumerate(_episodes(one, _plans())):
        (alone,) = _episodes(one, _plans(range(number, number + 1)))
        _same(after, alone, "an episode after others")


def _workers(one: Named) -> None:
    here = _episodes(one, _plans())
    with Rollouts(one.task, workers=2) as rollouts:
        there = list(rollouts.run(one.policy(), _plans()))
    for a, b in zip(here, there, strict=True):
        _same(a, b, "in two processes")


def _keeps(one: Named) -> None:
    for episode in _episodes(one, _plans()):
        read = arrays_of([episode], "contract").episode(0)  # as from a file
        kept = [one.collector.keeps(which) for which in (episode, read) * ASKED]
        for said in kept:
            truth = isinstance(said, bool | np.bool_)
            demand(truth, f"keeps says {said!r}, expected a bool")
        demand(len(set(kept)) == 1, "keeps says something else of the same episode")


def _replay(one: Named) -> None:
    with tempfile.TemporaryDirectory() as folder:
        location = locate(str(Path(folder, "contract-v0")))
        arrays = arrays_of(_episodes(one, _plans()), location.id)
        provenance = Provenance(
            task=one.task_name,
            overrides=one.overrides,
            collector=one.name,
            collector_config=asdict(one.collector.config()),
            seed=0,
        )
        write_dataset(location, arrays, provenance)
        problems = verify(location)
        demand(not problems, "; ".join(problems))
        different = [each for each in replay(load_dataset(location)) if each]
        demand(not different, "; ".join(different[:1]))


_CLAIMS: dict[str, Claim] = {
    "its settings can be recorded": _settings,
    "its actions are finite and within their bounds": _acts,
    "episodes follow from their seeds to the bit": _seeds,
    "an episode does not depend on those before": _remembers_nothing,
    "episodes are the same in several processes": _workers,
    "what it keeps depends on the episode alone": _keeps,
    "a dataset of it passes verify, and replays to the bit": _replay,
}


def collector_claims(one: Named) -> dict[str, Claim]:
    """Claims about a collector, by their words."""
    return _CLAIMS
