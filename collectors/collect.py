"""The collecting loop: run a policy until a dataset has enough steps.

Attempt i is seeded from (seed, i), and attempts are kept in the order of i. The result
therefore depends neither on the number of workers nor on interruptions. A dataset of N
steps is the shortest sequence of whole kept episodes with at least N steps, so that a
longer dataset begins with a shorter one.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count

from marl_mm.collectors.registry import successes
from marl_mm.envs.rollout import EpisodePlan, episode_seed
from marl_mm.episode import Episode
from marl_mm.errors import HopelessError, UsageError
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

RunEpisodes = Callable[[Policy, Iterable[EpisodePlan]], Generator[Episode, None, None]]
"""Function that runs episodes and yields each when it is finished, in any order; what
it returns is closed when there are enough."""

_HOPELESS = 200
"""Number of rejected attempts in a row after which the loop gives up."""


@dataclass(frozen=True)
class Collection:
    """Result of the collecting loop."""

    episodes: list[Episode]
    """Kept episodes, in order."""

    attempts: int
    """Number of episodes run, kept or not."""

    complete: bool
    """Whether the loop had its steps before Ctrl-C ended it."""


def collect(
    policy: Policy,
    keeps: Callable[[Episode], bool],
    run: RunEpisodes,
    steps: int,
    seed: int,
    advance: Advance = silent,
    earlier_attempts: Mapping[int, Episode | None] | None = None,
    keep_safe: Callable[[Episode], None] = lambda episode: None,
) -> Collection:
    """Collect whole episodes until they have ``steps`` steps, or until Ctrl-C.

    Args:
        policy: Policy that acts.
        keeps: Function that says whether an episode is kept.
        run: Function that runs the attempts.
        steps: Least number of steps of the kept episodes.
        seed: Seed of the collection.
        advance: Function that is called with the kept steps.
        earlier_attempts: Attempts made before, by number; None for a rejected one.
        keep_safe: Function that is called with each new attempt when it is finished.

    Raises:
        UsageError: If ``steps`` is not positive or ``seed`` is negative.
        HopelessError: If the policy hardly ever produces an episode to keep.
    """
    if steps < 1:
        raise UsageError(f"steps is {steps}, expected >= 1")
    if seed < 0:
        raise UsageError(f"seed is {seed}, expected >= 0")
    earlier_attempts = earlier_attempts or {}
    plans = (
        EpisodePlan(i, episode_seed(seed, i, "collect"))
        for i in count()
        if i not in earlier_attempts
    )
    attempts = run(policy, plans)
    kept: list[Episode] = []
    done = rejected = tried = 0
    try:
        for episode in _in_order(attempts, earlier_attempts, keep_safe):
            tried += 1
            if episode is not None and keeps(episode):
                kept.append(episode)
                advance(min(len(episode), steps - done), f"{len(kept)} episodes")
                done += len(episode)
                rejected = 0
            else:
                rejected += 1
            if done >= steps:
                return Collection(kept, tried, complete=True)
            if rejected >= _HOPELESS:
                wanting, cure = "made nothing to keep in", "change the policy"
                if keeps is successes:
                    wanting = "reached no goal in"
                    cure = f"allow more steps with `max_steps`, or {cure}"
                raise HopelessError(
                    f"{policy.name} {wanting} {rejected} episodes in a row: {cure}"
                )
    except KeyboardInterrupt:
        return Collection(kept, tried, complete=False)
    finally:
        attempts.close()
    raise AssertionError("plans are endless")


def _in_order(
    attempts: Iterator[Episode],
    earlier_attempts: Mapping[int, Episode | None],
    keep_safe: Callable[[Episode], None],
) -> Iterator[Episode | None]:
    """Attempts 0, 1, ... in order; new ones may finish in any order."""
    waiting: dict[int, Episode] = {}
    for number in count():
        if number in earlier_attempts:
            yield earlier_attempts[number]
            continue
        while number not in waiting:
            episode = next(attempts)
            keep_safe(episode)
            waiting[episode.index] = episode
        yield waiting.pop(number)
