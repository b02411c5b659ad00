"""Hyper-parameters of MAICQ; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED, CriticConfig
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class MaicqConfig(CriticConfig):
    """Hyper-parameters."""

    temperature: float = 0.1
    """Temperature of the weights in the actors' loss, alpha, in units of value; 0.1 in
    the source's code."""

    critic_temperature: float = 1.0
    """Temperature of the weights in the critics' loss; 10 to 1000 in the source's code,
    where it hardly weighs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("temperature", "critic_temperature"))


ALGORITHMS.add(
    "maicq",
    Algorithm(
        title="MAICQ",
        loss="softmax(A_i / alpha) MSE(a_i, pi_i(o_i)), agent after agent",
        about="MAICQ: in-sample critics, and agents improved one after the other.",
        source="Yang 2021",
        advice="Made for data of mixed quality; later agents suit what earlier ones "
        "have learnt. It stays near the data's actions. In the benchmark it is with "
        "the best from most data; MABC kept conventions better.",
        departs="Critics learn from one step's reward, in the source from returns of "
        "several (TD(lambda), 0.8), and their targets follow, in the source they are "
        "copied. The softmax weight multiplies the critics' loss, in the source the "
        "target. "
        "Critics are of the joint state and action, in the source mixed from the "
        "agents' own; agents learn one after the other, in the source beside each "
        "other. With the preset's temperatures few of a batch's 256 samples count, on "
        "`quiet-zone-noisy` after 5,000 updates about 17 for the critics and 4 and 1 "
        "for the actors, as (sum w)^2 / sum w^2: tune both. "
        f"{BOUNDED}",
        learner=Imported("marl_mm.algorithms.maicq:Maicq"),
        presets=presets_of("maicq", MaicqConfig()),
    ),
)
