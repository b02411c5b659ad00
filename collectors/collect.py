"""The collecting loop: run a policy until a dataset has its steps.

Attempt i is seeded from (seed, i) and attempts are kept in order of i, so the result
depends neither on the number of workers nor on when the loop was interrupted. A dataset
of N steps is the shortest run of whole kept episodes with at least N steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.envs.config import ReachConfig
from marl_mm.envs.rollout import EpisodePlan, episode_seed, run_episodes
from marl_mm.episode import Episode
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

PolicyConfig = PdConfig | RandomConfig

_HOPELESS = 200
"""Attempts in a row without one to keep, after which the loop gives up."""


@dataclass(frozen=True)
class Collector:
    """A policy and which of its episodes a dataset keeps."""

    policy: Policy
    keep: Callable[[Episode], bool]
    max_steps: int
    """Length of its episodes."""


@dataclass(frozen=True)
class Collection:
    """What the loop brought home."""

    episodes: list[Episode]
    attempts: int
    """Episodes run, kept or not."""

    complete: bool
    """False where Ctrl-C ended the loop early."""


def make_collector(config: PolicyConfig) -> Collector:
    """The collector a config describes: PD keeps successes, random keeps everything."""
    if isinstance(config, PdConfig):
        return Collector(PdPolicy(config), lambda episode: episode.success, 50)
    return Collector(RandomPolicy(config), lambda episode: True, 25)


def collect(
    collector: Collector,
    task: ReachConfig,
    steps: int,
    seed: int,
    workers: int = 1,
    advance: Advance = silent,
) -> Collection:
    """Collect whole episodes until they have ``steps`` steps, or until Ctrl-C.

    Args:
        collector: Who acts and what is kept.
        task: Where; its ``max_steps`` is the episodes' length.
        steps: Least number of steps of the kept episodes.
        seed: Of the whole collection.
        workers: Processes.
        advance: Told the kept steps.

    Raises:
        UsageError: If ``steps`` is not positive or ``seed`` is negative.
        MarlMmError: If the collector hardly ever produces an episode to keep.
    """
    if steps < 1:
        raise UsageError(f"steps is {steps}, expected >= 1")
    if seed < 0:
        raise UsageError(f"seed is {seed}, expected >= 0")
    plans = (EpisodePlan(i, episode_seed(seed, i, "collect")) for i in count())
    attempts = run_episodes(task, collector.policy, plans, workers)
    kept: list[Episode] = []
    done = rejected = tried = 0
    try:
        for episode in attempts:
            tried = episode.index + 1
            if collector.keep(episode):
                kept.append(episode)
                advance(min(len(episode), steps - done), f"{len(kept)} episodes")
                done += len(episode)
                rejected = 0
            else:
                rejected += 1
            if done >= steps:
                return Collection(kept, tried, complete=True)
            if rejected >= _HOPELESS:
                raise MarlMmError(
                    f"{collector.policy.name} reached no goal in {rejected} episodes "
                    f"in a row of at most {task.max_steps} steps: allow more with "
                    "--max-steps, or change its gains or alpha"
                )
    except KeyboardInterrupt:
        return Collection(kept, tried, complete=False)
    finally:
        attempts.close()  # type: ignore[attr-defined]
    raise AssertionError("plans are endless")
