"""What every metric keeps to."""

import math
import pickle
from dataclasses import dataclass

from marl_mm.contracts.claims import Claim, demand
from marl_mm.contracts.tasks import episodes, short
from marl_mm.envs.registry import DEFAULT
from marl_mm.episode import Episode
from marl_mm.eval.metrics import METRICS, Metric


@dataclass(frozen=True)
class Named:
    """A metric, its name and episodes to measure."""

    name: str
    metric: Metric
    episodes: list[Episode]


def named(name: str, task: str = DEFAULT) -> Named:
    """A registered metric, on random episodes of a task."""
    return Named(name, METRICS.get(name), episodes(short(task)))


def _numbers(one: Named) -> None:
    for episode in one.episodes:
        value = one.metric.measure(one.name, episode)
        demand(value is None or math.isfinite(value), f"it is {value}")


def _follows(one: Named) -> None:
    for episode in one.episodes:
        before = pickle.dumps(episode)
        first, again = (one.metric.value(episode) for _ in range(2))
        demand(first == again, f"it is {first}, then {again}")
        demand(pickle.dumps(episode) == before, "it changes the episode")


_CLAIMS: dict[str, Claim] = {
    "it is a finite number, or None": _numbers,
    "it follows from the episode, which stays as it is": _follows,
}


def metric_claims(one: Named) -> dict[str, Claim]:
    """Claims about a metric, by their words."""
    return _CLAIMS
