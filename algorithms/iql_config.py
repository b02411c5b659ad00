"""Hyper-parameters of IQL and MA-IQL; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import CriticConfig
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm, imported


@dataclass(frozen=True, kw_only=True)
class IqlConfig(CriticConfig):
    """Hyper-parameters: the source's where it names them."""

    expectile: float = 0.7
    """Expectile of V's loss, tau (Kostrikov 2022, Sec. 5)."""

    temperature: float = 3.0
    """Weight of the advantage in the actors' loss, beta (Kostrikov 2022, Sec. 5)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, (), ("temperature",), ("expectile",))


ALGORITHMS.add(
    "iql",
    Algorithm(
        about="IQL: in-sample values, advantage-weighted cloning, one joint actor.",
        source="Kostrikov 2022",
        learner=imported("marl_mm.algorithms.iql:Iql"),
        presets={TUNED: IqlConfig()},
    ),
)
ALGORITHMS.add(
    "ma-iql",
    Algorithm(
        about="MA-IQL: IQL's values of the whole team, and an actor for each agent.",
        source="Kostrikov 2022",
        learner=imported("marl_mm.algorithms.iql:MaIql"),
        presets={TUNED: IqlConfig()},
    ),
)
