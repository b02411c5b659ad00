"""The collecting loop: run a policy until a dataset has its steps.

Attempt i is seeded from (seed, i) and attempts are kept in order of i, so the result
depends neither on the number of workers nor on when the loop was interrupted. A dataset
of N steps is the shortest run of whole kept episodes with at least N steps, so that a
longer one begins with the shorter.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count

from marl_mm.collectors.medium import MediumConfig, MediumPolicy
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.pretrained import PretrainedConfig, PretrainedPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.scripted import ScriptedConfig, ScriptedPolicy
from marl_mm.envs.config import ReachConfig
from marl_mm.envs.rollout import EpisodePlan, episode_seed
from marl_mm.episode import Episode
from marl_mm.errors import HopelessError, UsageError
from marl_mm.layout import HANDLING
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

PolicyConfig = (
    PdConfig | RandomConfig | PretrainedConfig | MediumConfig | ScriptedConfig
)

RunEpisodes = Callable[[Policy, Iterable[EpisodePlan]], Iterator[Episode]]
"""Runs episodes and yields each when it is finished, in whatever order."""

_HOPELESS = 200
"""Attempts in a row without one to keep, after which the loop gives up."""


@dataclass(frozen=True)
class Collector:
    """A policy and which of its episodes a dataset keeps."""

    policy: Policy
    keep: Callable[[Episode], bool]


@dataclass(frozen=True)
class Collection:
    """What the loop brought home."""

    episodes: list[Episode]
    attempts: int
    """Episodes run, kept or not."""

    complete: bool
    """False where Ctrl-C ended the loop early."""


def make_collector(config: PolicyConfig) -> Collector:
    """The collector a config describes: experts keep successes, others everything.

    Raises:
        UsageError: If it names an agent that does not exist.
    """
    if isinstance(config, PdConfig):
        return Collector(PdPolicy(config), _reached)
    if isinstance(config, PretrainedConfig):
        return Collector(PretrainedPolicy(config), _reached)
    if isinstance(config, ScriptedConfig):
        return Collector(ScriptedPolicy(config), _reached)
    if isinstance(config, MediumConfig):
        return Collector(MediumPolicy(config), _whatever)
    return Collector(RandomPolicy(config), _whatever)


def usual_steps(config: PolicyConfig, task: ReachConfig) -> int:
    """Length of a collector's episodes where nobody says another.

    As in the paper (Sec. 5.4); where there is a block to be taken, the task's.
    """
    if task.layout is HANDLING:
        return task.max_steps
    return 50 if isinstance(config, PdConfig) else 25


def collect(
    collector: Collector,
    run: RunEpisodes,
    steps: int,
    seed: int,
    advance: Advance = silent,
    known: Mapping[int, Episode | None] | None = None,
    keep_safe: Callable[[Episode], None] = lambda episode: None,
) -> Collection:
    """Collect whole episodes until they have ``steps`` steps, or until Ctrl-C.

    Args:
        collector: Who acts and what is kept.
        run: Runs the attempts.
        steps: Least number of steps of the kept episodes.
        seed: Of the whole collection.
        advance: Told the kept steps.
        known: Attempts that were made before, by number; None for one that was not
            kept.
        keep_safe: Told each new attempt as soon as it is finished.

    Raises:
        UsageError: If ``steps`` is not positive or ``seed`` is negative.
        HopelessError: If the collector hardly ever produces an episode to keep.
    """
    if steps < 1:
        raise UsageError(f"steps is {steps}, expected >= 1")
    if seed < 0:
        raise UsageError(f"seed is {seed}, expected >= 0")
    known = known or {}
    plans = (
        EpisodePlan(i, episode_seed(seed, i, "collect"))
        for i in count()
        if i not in known
    )
    attempts = run(collector.policy, plans)
    kept: list[Episode] = []
    done = rejected = tried = 0
    try:
        for episode in _in_order(attempts, known, keep_safe):
            tried += 1
            if episode is not None and collector.keep(episode):
                kept.append(episode)
                advance(min(len(episode), steps - done), f"{len(kept)} episodes")
                done += len(episode)
                rejected = 0
            else:
                rejected += 1
            if done >= steps:
                return Collection(kept, tried, complete=True)
            if rejected >= _HOPELESS:
                raise HopelessError(
                    f"{collector.policy.name} reached no goal in {rejected} episodes "
                    "in a row: allow more steps with --max-steps, or change what acts"
                )
    except KeyboardInterrupt:
        return Collection(kept, tried, complete=False)
    finally:
        attempts.close()  # type: ignore[attr-defined]
    raise AssertionError("plans are endless")


def _in_order(
    attempts: Iterator[Episode],
    known: Mapping[int, Episode | None],
    keep_safe: Callable[[Episode], None],
) -> Iterator[Episode | None]:
    """Attempts 0, 1, ..., the known ones and new ones that come in any order."""
    waiting: dict[int, Episode] = {}
    for number in count():
        if number in known:
            yield known[number]
            continue
        while number not in waiting:
            episode = next(attempts)
            keep_safe(episode)
            waiting[episode.index] = episode
        yield waiting.pop(number)


def _reached(episode: Episode) -> bool:
    return episode.success


def _whatever(episode: Episode) -> bool:
    return True
