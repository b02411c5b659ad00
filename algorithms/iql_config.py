"""Hyper-parameters of IQL and MA-IQL; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import CriticConfig
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


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
        title="IQL",
        loss="exp(beta (Q(s, a) - V(s))) MSE(a, pi(s))",
        about="IQL: in-sample values, advantage-weighted cloning, one joint actor.",
        source="Kostrikov 2022",
        advice="Where good and bad steps are mixed and no critic shall be asked for "
        "actions that the data do not show, so that it cannot run away. It remains "
        "weighted cloning: on good data the weights are nearly equal, so that BC is "
        "enough, and it never goes beyond the data's actions.",
        departs="Actors give one action and imitate by squared errors, as all here; "
        "the source fits a Gaussian by likelihood. Their advantage is that before V's "
        "step, the source's that after it. Normalised critics and clipped "
        "targets are ours, as for TD3+BC.",
        learner=Imported("marl_mm.algorithms.iql:Iql"),
        presets=presets_of("iql", IqlConfig()),
    ),
)
ALGORITHMS.add(
    "ma-iql",
    Algorithm(
        title="MA-IQL",
        loss="exp(beta (Q(s, a) - V(s))) MSE(a_i, pi_i(o_i)), for each agent i",
        about="MA-IQL: IQL's values of the whole team, and an actor for each agent.",
        source="Kostrikov 2022",
        advice="As IQL, where agents act on their own observations. The advantage is "
        "the whole team's: a good action beside another agent's bad one weighs as "
        "little as that.",
        departs="The source knows no agents: V and Q are the team's, and each agent's "
        "cloning has the same weights. Otherwise as IQL.",
        learner=Imported("marl_mm.algorithms.iql:MaIql"),
        presets=presets_of("ma-iql", IqlConfig()),
    ),
)
