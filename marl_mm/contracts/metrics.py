"""Claims that hold of every metric."""

import math
import pickle
from copy import deepcopy
from dataclasses import dataclass

from marl_mm.contracts.claims import Claim, demand
from marl_mm.contracts.episodes import short
from marl_mm.envs.registry import DEFAULT
from marl_mm.episode import Episode
from marl_mm.eval.metrics import METRICS, Metric


@dataclass(frozen=True)
class Candidate:
    """A metric under test."""

    name: str
    """Registered name."""

    metric: Metric
    """The metric."""

    episodes: list[Episode]
    """Episodes to measure."""


def candidate(name: str, task: str = DEFAULT) -> Candidate:
    """A registered metric, to be tested on random episodes of a task."""
    return Candidate(name, METRICS.get(name), short(task).episodes)


def _numbers(candidate: Candidate) -> None:
    for episode in candidate.episodes:
        value = candidate.metric.measure(candidate.name, deepcopy(episode))
        demand(value is None or math.isfinite(value), f"it is {value}")


def _follows(candidate: Candidate) -> None:
    for episode in candidate.episodes:
        before = pickle.dumps(episode)
        first, again = (candidate.metric.value(episode) for _ in range(2))
        demand(first == again, f"it is {first}, then {again}")
        demand(pickle.dumps(episode) == before, "it changes the episode")


_CLAIMS: dict[str, Claim] = {
    "it is a finite number, or None": _numbers,
    "it follows from the episode, which stays as it is": _follows,
}


def metric_claims(candidate: Candidate) -> dict[str, Claim]:
    """Claims about a metric, by their texts."""
    return _CLAIMS
