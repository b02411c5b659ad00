"""Episodes of others that online learning replays beside its own (paper, Sec. 4.3)."""

from collections.abc import Sequence

import numpy as np

from marl_mm.algorithms.replay import Batch, Judge, Replay, concatenated
from marl_mm.episode import Episode


class Demonstrations:
    """Successful episodes and others, drawn in a set ratio.

    Args:
        episodes: Episodes of both kinds; possibly none.
        successes: Share of the transitions drawn that comes from successful episodes,
            if there are both kinds.
        hindsight: Relabelled transitions per original one.
        judge: The task's reward and termination.
    """

    def __init__(
        self,
        episodes: Sequence[Episode],
        successes: float,
        hindsight: int,
        judge: Judge,
    ) -> None:
        kinds = (True, successes), (False, 1 - successes)
        self._parts: list[tuple[Replay, float]] = []
        for success, share in kinds:
            subset = [episode for episode in episodes if episode.success == success]
            if subset:
                size = sum(map(len, subset))
                replay = Replay(size, hindsight, judge, subset[0].layout)
                for episode in subset:
                    replay.add(episode)
                self._parts.append((replay, share))
        if len(self._parts) == 1:  # one kind only
            self._parts = [(self._parts[0][0], 1.0)]

    def __bool__(self) -> bool:
        return bool(self._parts)

    def sample(self, size: int, rng: np.random.Generator) -> Batch:
        """Draw transitions, in random order."""
        kinds = rng.choice(
            len(self._parts), size=size, p=[share for _, share in self._parts]
        )
        drawn = [
            replay.sample(int((kinds == kind).sum()), rng)
            for kind, (replay, _) in enumerate(self._parts)
        ]
        order = np.argsort(np.argsort(kinds, kind="stable"), kind="stable")
        return concatenated(drawn).take(order)
