"""Claims that hold of every collector."""

import json
import tempfile
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.collectors.replay import replay
from marl_mm.contracts.claims import Claim, demand, demand_same
from marl_mm.contracts.episodes import EPISODES, demand_inside, short
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
"""Steps of an episode in which a collector is tested."""

ASKED = 4
"""Number of times that it is asked whether it keeps an episode, run or read."""


@dataclass(frozen=True)
class Candidate:
    """A collector under test."""

    name: str
    """Registered name."""

    collector: Collector
    """The collector."""

    task_name: str
    """Registered name of the task that it is tested in."""

    task: Task
    """That task, shortened, on MuJoCo."""

    overrides: Mapping[str, Any]
    """Fields of the task that were replaced."""

    def policy(self) -> Policy:
        """The policy of the default settings."""
        policy: Policy = self.collector.policy(self.collector.config(), self.task)
        return policy


def candidate(name: str, task: str = DEFAULT) -> Candidate:
    """A registered collector, to be tested in a registered task."""
    few = short(task)
    overrides = {**few.overrides, "max_steps": max(LONG, few.task.max_steps)}
    variant = make_task(task, overrides)
    return Candidate(name, COLLECTORS.get(name), task, variant, overrides)


def _plans(numbers: range = range(EPISODES)) -> list[EpisodePlan]:
    return [EpisodePlan(i, episode_seed(0, i, "collect")) for i in numbers]


def _episodes(candidate: Candidate, plans: list[EpisodePlan]) -> list[Episode]:
    policy = candidate.policy()
    with closing(EpisodeCore(candidate.task)) as core:
        return [run_episode(core, policy, plan) for plan in plans]


def _same(here: Episode, there: Episode, where: str) -> None:
    for name in ("states", "actions", "rewards", "terminated", "truncated"):
        demand_same(getattr(here, name), getattr(there, name), f"{where}: {name}")


def _settings(candidate: Candidate) -> None:
    config, policy = candidate.collector.config(), candidate.policy()
    how = getattr(config, "__dataclass_params__", None)
    demand(how is not None and how.frozen, "its config is no frozen dataclass")
    json.dumps(asdict(config))
    json.dumps(policy.describe())
    demand(config == candidate.collector.config(), "two default configs differ")
    demand(policy.name == candidate.name, f"its policy calls itself {policy.name!r}")


def _acts(candidate: Candidate) -> None:
    layout, policy = candidate.task.layout, candidate.policy()
    with closing(EpisodeCore(candidate.task)) as core:
        for plan in _plans():
            state, ended = core.reset(np.random.default_rng(plan.seed)), False
            policy.begin(np.random.default_rng([plan.seed, 1]), layout)
            while not ended:
                action = policy.act(state.copy())
                right = action.shape == (len(layout.action),)
                right = right and action.dtype == np.float32
                demand(right, f"an action is {action.dtype} of shape {action.shape}")
                demand(np.isfinite(action).all(), "an action is not finite")
                demand_inside(action, layout, "an action is")
                step = core.step(action)
                state, ended = step.state, step.terminated or step.truncated


def _seeds(candidate: Candidate) -> None:
    first, again = (_episodes(candidate, _plans()) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        _same(a, b, "the same seed")


def _remembers_nothing(candidate: Candidate) -> None:
    for number, after in enumerate(_episodes(candidate, _plans())):
        (alone,) = _episodes(candidate, _plans(range(number, number + 1)))
        _same(after, alone, "an episode after others")


def _workers(candidate: Candidate) -> None:
    """On the default engine: MuJoCo's workers may be threads."""
    own = {n: v for n, v in candidate.overrides.items() if n != "simulation"}
    variant = make_task(candidate.task_name, own)
    here = _episodes(replace(candidate, task=variant), _plans())
    with Rollouts(variant, workers=2) as rollouts:
        there = list(rollouts.run(candidate.policy(), _plans()))
    for a, b in zip(here, there, strict=True):
        _same(a, b, "in two processes")


def _keeps(candidate: Candidate) -> None:
    for episode in _episodes(candidate, _plans()):
        read = arrays_of([episode], "contract").episode(0)  # as from a file
        kept = [candidate.collector.keeps(either) for either in (episode, read) * ASKED]
        for answer in kept:
            truth = isinstance(answer, bool | np.bool_)
            demand(truth, f"keeps says {answer!r}, expected a bool")
        demand(len(set(kept)) == 1, "keeps says something else of the same episode")


def _replay(candidate: Candidate) -> None:
    with tempfile.TemporaryDirectory() as folder:
        location = locate(str(Path(folder, "contract-v0")))
        arrays = arrays_of(_episodes(candidate, _plans()), location.id)
        provenance = Provenance(
            task=candidate.task_name,
            overrides=candidate.overrides,
            collector=candidate.name,
            collector_config=asdict(candidate.collector.config()),
            seed=0,
        )
        write_dataset(location, arrays, provenance)
        problems = verify(location)
        demand(not problems, "; ".join(problems))
        changes = [text for text in replay(load_dataset(location)) if text]
        demand(not changes, "; ".join(changes[:1]))


_CLAIMS: dict[str, Claim] = {
    "its settings can be recorded": _settings,
    "its actions are finite and within their bounds": _acts,
    "episodes follow from their seeds to the bit": _seeds,
    "an episode does not depend on those before": _remembers_nothing,
    "episodes are the same in several processes": _workers,
    "what it keeps depends on the episode alone": _keeps,
    "a dataset of it passes verify, and replays to the bit": _replay,
}


def collector_claims(candidate: Candidate) -> dict[str, Claim]:
    """Claims about a collector, by their texts."""
    return _CLAIMS
