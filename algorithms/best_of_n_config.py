"""Hyper-parameters of best-of-n students; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import CriticConfig
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class BestOfNConfig(CriticConfig):
    """Hyper-parameters."""

    samples: int = 16
    """Actions that the flow proposes for each state, n."""

    picked: int = 64
    """Number of a batch's states, at most the batch, for which actions are proposed and
    the best is cloned: it takes most of an update's time."""

    expectile: float = 0.7
    """Expectile of V's loss, tau (Kostrikov 2022, Sec. 5)."""

    flow_steps: int = 10
    """Euler steps from noise to a proposed action (Park 2025, FQL)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("samples", "picked", "flow_steps"), (), ("expectile",))


ALGORITHMS.add(
    "best-of-n",
    Algorithm(
        title="Best-of-n students",
        loss="MSE(a*_i, pi_i(o_i)), for each agent i, a* = argmax of Q(s, a) "
        "among n samples a of a joint flow",
        about="Best-of-n students: agents clone the best of n samples of a joint flow.",
        source="ours",
        advice="Use it where the data mix several ways of a team and rewards tell them "
        "apart, be it a little. Where all of the data are good and of one way, the "
        "best of n follows the critics' errors: clone. An update takes two to three "
        "times as long as IQL's; acting is as fast as MABC.",
        learner=Imported("marl_mm.algorithms.best_of_n:BestOfN"),
        presets=presets_of("best-of-n", BestOfNConfig()),
    ),
)
ALGORITHMS.add(
    "best-of-n-joint",
    Algorithm(
        title="Best-of-n student, joint",
        loss="MSE(a*, pi(s)), a* = argmax of Q(s, a) among n samples a of a flow",
        about="Best-of-n student: one actor clones the best of n samples of a flow.",
        source="ours",
        advice="Use it to see what decentralised acting costs best-of-n students.",
        learner=Imported("marl_mm.algorithms.best_of_n:BestOfNJoint"),
        presets=presets_of("best-of-n-joint", BestOfNConfig()),
    ),
)
