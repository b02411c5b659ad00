"""Hyper-parameters of RLPD and MA-RLPD; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED, Td3Config
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm, Imported
from marl_mm.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class RlpdConfig(Td3Config):
    """Hyper-parameters."""

    updates: int = 0
    """Number of gradient steps before the first own episode; none in the source."""

    critics: int = 10
    """Number of critics, an even one (Ball 2023)."""

    action_penalty: float = 0.05
    """Weight of the mean square of the action in the actors' loss."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("critics",), ("action_penalty",))
        if self.critics % 2:
            raise UsageError(f"critics is {self.critics}, expected an even number")


_DEPARTS = (
    "The actor is TD3's, with noise for the entropy of the source's SAC. It improves "
    "at every second update, and targets follow then; in the source it improves at "
    "every twentieth, and targets follow at each. There is 1 update per step unless "
    "`updates_per_step` says otherwise, 20 in the source. The first "
    "episodes are the untrained actor's, with noise; halves of a batch are halves by "
    f"chance. The penalty on actions is ours. {BOUNDED}"
)

ALGORITHMS.add(
    "rlpd",
    Algorithm(
        title="RLPD",
        loss="-mean_j Q_j(s, pi(s)) + penalty mean pi(s)^2",
        about="RLPD: learns online with a dataset at hand, by one actor that sees all.",
        source="Ball 2023",
        advice="To compare a start from nothing, with the data at hand: going on from "
        "MATD3+BC reached more on all three datasets of the fine-tuning study, on two "
        "of them with intervals apart. Say "
        "`online_steps`; without own episodes it imitates nothing and fails.",
        departs=_DEPARTS,
        learner=Imported("marl_mm.algorithms.rlpd:Rlpd"),
        presets={TUNED: RlpdConfig()},
    ),
)
ALGORITHMS.add(
    "ma-rlpd",
    Algorithm(
        title="MA-RLPD",
        loss="-mean_j Q_j(s, (pi_i(o_i), a_-i)) + penalty mean pi_i(o_i)^2",
        about="RLPD with joint critics and an actor for each agent.",
        source="Ball 2023; team form ours",
        advice="As RLPD, where each agent must act on what it sees itself.",
        departs=_DEPARTS,
        learner=Imported("marl_mm.algorithms.rlpd:MaRlpd"),
        presets={TUNED: RlpdConfig()},
    ),
)
