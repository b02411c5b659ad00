"""Hyper-parameters of flow-matching cloning; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import CloningConfig
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class FlowBcConfig(CloningConfig):
    """Hyper-parameters."""

    flow_steps: int = 10
    """Euler steps from noise to action (Park 2025, FQL)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("flow_steps",))


ALGORITHMS.add(
    "flow-bc",
    Algorithm(
        title="Flow BC",
        loss="|v(s, (1 - t) z + t a, t) - (a - z)|^2",
        about="Flow-matching cloning: a joint actor that draws among the data's ways.",
        source="Lipman 2023",
        advice="Where the data show several ways of which a mean is none, as with two "
        "conventions of a team, and one actor may see everything; it takes many "
        "updates. From data of one way take BC, whose action takes one pass of the "
        "network in place of ten. Flow BC imitates failures as well.",
        departs="The source makes images; cloning by it, with ten Euler steps, is as "
        "in Park 2025. Actions end at their bounds.",
        learner=Imported("marl_mm.algorithms.flow_bc:FlowBc"),
        presets=presets_of("flow-bc", FlowBcConfig()),
    ),
)
ALGORITHMS.add(
    "ma-flow-bc",
    Algorithm(
        title="MA-Flow BC",
        loss="|v_i(o_i, (1 - t) z_i + t a_i, t) - (a_i - z_i)|^2, for each agent i",
        about="Flow-matching cloning by agents that draw independently.",
        source="Lipman 2023",
        advice="Where each agent has several ways of its own that go with any of the "
        "others'. Not where agents have to choose the same one: they draw "
        "independently, and half of the pairs of two conventions mix them.",
        departs="The source knows no agents; otherwise as flow BC.",
        learner=Imported("marl_mm.algorithms.flow_bc:MaFlowBc"),
        presets=presets_of("ma-flow-bc", FlowBcConfig()),
    ),
)
