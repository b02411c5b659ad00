"""Hyper-parameters of MAC-Flow; importing them takes no torch."""

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.fql_config import FqlConfig
from marl_mm.algorithms.offline_config import BOUNDED
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported

ALGORITHMS.add(
    "mac-flow",
    Algorithm(
        title="MAC-Flow",
        loss="-lambda Q(s, (pi_i(o_i, z_i), a_-i)) + alpha MSE(teacher(s, z)_i, "
        "pi_i(o_i, z_i)), for each agent i",
        about="MAC-Flow: one-step actors of agents between a joint flow and a critic.",
        source="Lee 2025",
        advice="Use it where each agent may vary by itself. It does not keep "
        "conventions of the data: an agent does not know the others' noise, and "
        "learns a mean over what they may do. The smaller `distillation`, the more "
        "the critic decides. Like FQL it repeats the data's noise.",
        departs="Critics are of the joint state and action, in the source means of "
        "those of each agent's own. The rest is as in FQL: actions end in a tanh, the "
        f"weight of the value is divided by its mean size. {BOUNDED}",
        learner=Imported("marl_mm.algorithms.mac_flow:MacFlow"),
        presets=presets_of("mac-flow", FqlConfig()),
    ),
)
