"""Hyper-parameters of OMAR; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.cfcql_config import CfcqlConfig
from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported
from marl_mm.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class OmarConfig(CfcqlConfig):
    """Hyper-parameters: those of CFCQL's critics, and of the search for actions."""

    focus: float = 0.0
    """Weight of an agent's distance from the data in its share of the conservative
    term; 0, as all shares are the same in the source."""

    mix: float = 0.9
    """Weight of the found action against the value in the actors' loss; 0.1 to 1 in the
    source's code, by dataset."""

    searched: int = 64
    """Number of a batch's transitions that actions are searched for, at most the batch;
    all of it in the source."""

    rounds: int = 3
    """Rounds of the search."""

    candidates: int = 10
    """Actions drawn in each round."""

    elites: int = 5
    """Best actions so far, whose mean and deviation the next round has; the 5 best of
    20 in the source's code for robots."""

    search_spread: float = 1.0
    """Standard deviation of the first round's actions, in halves of their range; 2 in
    the source's code, where six of ten lie at the bounds."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = "searched", "rounds", "candidates", "elites", "search_spread"
        check_ranges(self, positive, shares=("mix",))
        if self.elites > self.candidates:
            raise UsageError(
                f"elites is {self.elites}, expected at most candidates, which is "
                f"{self.candidates}"
            )


ALGORITHMS.add(
    "omar",
    Algorithm(
        title="OMAR",
        loss="-(1 - c) Q_1(s, (pi_i(o_i), a_-i)) + c MSE(best_i, pi_i(o_i))",
        about="OMAR: conservative critics, and actors that follow a search.",
        source="Pan 2022",
        advice="In games worked by hand its search crosses valleys between ways of "
        "different worth, which CFCQL's gradient does not. On this robot it is among "
        "the first from slow noise in `moving-reach-explore` and from the rare "
        "successes of `quiet-zone-rare`, there with seeds from 24 to 70 %, and reaches "
        "6 % or less from the benchmark's other data: try others first. It is slow.",
        departs="Critics are of the joint state and action, in the source of each "
        "agent's own. They are conservative where one agent leaves the data, while "
        "actors and targets take what all do now: where several agents have left, "
        "values are not held down. An actor's own action is among the elites from the "
        "first round, in the source it is compared at the end. Targets have noise, and "
        "actors follow every second update, as in TD3; the source has neither. The "
        f"source clips the gradients of critics and actors. {BOUNDED}",
        learner=Imported("marl_mm.algorithms.omar:Omar"),
        presets=presets_of("omar", OmarConfig()),
    ),
)
