"""Hyper-parameters of FQL; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED, CriticConfig
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class FqlConfig(CriticConfig):
    """Hyper-parameters: the source's where it names them."""

    distillation: float = 10.0
    """Weight of the distance to the teacher's actions, alpha (Park 2025, who tune it
    for each task; 3 in the instructions of MAC-Flow's code)."""

    flow_steps: int = 10
    """Euler steps from noise to the teacher's action (Park 2025)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("flow_steps",), ("distillation",))


ALGORITHMS.add(
    "fql",
    Algorithm(
        title="FQL",
        loss="-lambda Q(s, pi(s, z)) + alpha MSE(teacher(s, z), pi(s, z)), "
        "lambda = 1 / mean |Q(s, pi(s, z))|",
        about="FQL: a one-step actor between a flow of the data and a critic.",
        source="Park 2025",
        advice="Use it where the data show several ways and one actor may see and set "
        "everything. `distillation` needs tuning: the smaller it is, the more the "
        "critic decides, also on actions that the data do not show. It acts by fresh "
        "noise at every step, and so repeats the data's noise, which cloning averages "
        "away: on noisy data cloning is better.",
        departs="Actions of the actor end in a tanh, in the source they are clipped; "
        "the weight of the value is always divided by its mean size, an option of the "
        f"source. {BOUNDED}",
        learner=Imported("marl_mm.algorithms.fql:Fql"),
        presets=presets_of("fql", FqlConfig()),
    ),
)
