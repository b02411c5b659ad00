"""Q-chunking (Li 2025): FQL whose actions are chunks of h steps, in the form QC-FQL.

Loss of the twin critics: (Q_j(s, a_1..h) - sum_i gamma^(i-1) r_i - gamma^h
(1 - terminated) mean_j Q_j'(s_h, a'_1..h))^2, where a' is the actor's chunk; of flow
and actor: as in ``fql``, of chunks. It acts h steps by one chunk, then plans again.
Of the source's two forms, QC-FQL is the one that acts by one network: the other, QC,
has the critic pick among samples of the flow at each plan.

Ours: where an episode ends within a chunk, its last action is repeated, the flow does
not imitate beyond the end, and the critics learn from the steps that there are; the
source leaves such chunks out of the critics' loss. Ours, too, is the team form:
agents plan chunks of their own actions, as in ``mac_flow``; the source has one agent.
And what FQL has of ours.
"""

from collections.abc import Sequence
from typing import ClassVar

from marl_mm.algorithms.fql import Fql
from marl_mm.algorithms.q_chunking_config import QChunkingConfig
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays


class QChunking(Fql):
    """Learns chunks of one actor that sees and sets everything; see ``Fql``."""

    name: ClassVar[str] = "q-chunking"
    config: QChunkingConfig

    def __init__(
        self,
        config: QChunkingConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device, chunk=config.chunk)


class MaQChunking(QChunking):
    """The same with an actor for each agent, which plans the agent's own actions."""

    name: ClassVar[str] = "ma-q-chunking"
    team = True
