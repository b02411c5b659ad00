"""Hyper-parameters of MABC, by preset; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.offline_config import CloningConfig
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class MabcConfig(CloningConfig):
    """Hyper-parameters; the paper's where it names them (Table 3)."""

    updates: int = 8_000
    """Gradient steps per actor; the paper has 100,000 (Table 3). On its datasets but
    the mixes, learning curves are at their end after 5,000 (eval/results/studies)."""


ALGORITHMS.add(
    "bc",
    Algorithm(
        title="BC",
        loss="MSE(a, pi(s))",
        about="Behaviour cloning with one actor that sees and sets everything.",
        source="paper, Sec. 4.4",
        advice="The joint counterpart of MABC; which of the two reaches more depends "
        "on the data. Both aim at the mean where the data show several ways.",
        departs="The paper clones with an actor for each agent only.",
        learner=Imported("marl_mm.algorithms.mabc:Bc"),
        presets=presets_of("bc", MabcConfig()),
    ),
)
ALGORITHMS.add(
    "mabc",
    Algorithm(
        title="MABC",
        loss="MSE(a_i, pi_i(o_i)), for each agent i",
        about="MABC: behaviour cloning with decentralised actors (paper, Sec. 4.4).",
        source="paper, Sec. 4.4",
        advice="Start here: good data are enough for it, it takes a block and carries "
        "it where learners with critics fail, and nothing can run away. It imitates "
        "random steps too, does as its data do whatever the task pays, and acts "
        "between two ways where they show both.",
        learner=Imported("marl_mm.algorithms.mabc:Mabc"),
        presets=presets_of("mabc", MabcConfig())
        | {PAPER: MabcConfig(updates=100_000, batch_size=256, learning_rate=5e-4)},
    ),
)
