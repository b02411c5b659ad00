"""Hyper-parameters of Q-chunking; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.fql_config import FqlConfig
from marl_mm.algorithms.offline_config import BOUNDED
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported
from marl_mm.errors import UsageError

LONGEST_CHUNK = 100
"""Largest number of actions in a chunk."""


@dataclass(frozen=True, kw_only=True)
class QChunkingConfig(FqlConfig):
    """Hyper-parameters: those of FQL, and the chunk's length."""

    chunk: int = 3
    """Actions in a row that are planned at once, h; the source has 5."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("chunk",))
        if self.chunk > LONGEST_CHUNK:
            raise UsageError(
                f"chunk is {self.chunk}, expected at most {LONGEST_CHUNK} steps"
            )
        if self.chunk > 1 and self.future + self.elsewhere > 0:
            raise UsageError(
                f"future is {self.future} and elsewhere {self.elsewhere}, expected 0: "
                "chunks of several steps keep their goals"
            )


_DEPARTS = (
    "Where an episode ends within a chunk, its last action is repeated, and the "
    "critics learn from the steps that there are; the source leaves such chunks out of "
    "their loss. The rest is as in FQL: actions end in a tanh, the weight of the value "
    f"is divided by its mean size. {BOUNDED}"
)

ALGORITHMS.add(
    "q-chunking",
    Algorithm(
        title="Q-chunking",
        loss="-lambda Q(s, pi(s, z)) + alpha MSE(teacher(s, z), pi(s, z)), of h "
        "actions in a row",
        about="Q-chunking: FQL of chunks of actions, acted without looking between.",
        source="Li 2025",
        advice="Use it on long tasks whose rewards are rare and whose data hold to a "
        "way for several steps. Within a chunk it reacts to nothing: leave it where "
        "what is seen changes fast. Like FQL it repeats the data's noise.",
        departs=_DEPARTS,
        learner=Imported("marl_mm.algorithms.q_chunking:QChunking"),
        presets=presets_of("q-chunking", QChunkingConfig()),
    ),
)
ALGORITHMS.add(
    "ma-q-chunking",
    Algorithm(
        title="MA-Q-chunking",
        loss="-lambda Q(s, (pi_i(o_i, z_i), a_-i)) + alpha MSE(teacher(s, z)_i, "
        "pi_i(o_i, z_i)), for each agent i, of h actions in a row",
        about="Q-chunking of a team: each agent plans a chunk of its own actions.",
        source="Li 2025 and Lee 2025; put together by us",
        advice="Use it where Q-chunking suits and each agent acts on its own "
        "observation. It does not keep conventions of the data, see MAC-Flow. Within a "
        "chunk an agent reacts to nothing, what the others do included. Like FQL it "
        "repeats the data's noise.",
        departs="The source has one agent; here each plans its own, as in MAC-Flow. "
        + _DEPARTS,
        learner=Imported("marl_mm.algorithms.q_chunking:MaQChunking"),
        presets=presets_of("ma-q-chunking", QChunkingConfig()),
    ),
)
