"""Hyper-parameters of Cal-QL and MA-Cal-QL; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.cfcql_config import CfcqlConfig
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm, Imported
from marl_mm.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class CalQlConfig(CfcqlConfig):
    """Hyper-parameters, those of CFCQL."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.future + self.elsewhere > 0:
            raise UsageError(
                f"future is {self.future} and elsewhere {self.elsewhere}, expected 0: "
                "the return of the data is known for their own goals only"
            )


ALGORITHMS.add(
    "cal-ql",
    Algorithm(
        title="Cal-QL",
        loss="-Q_1(s, pi(s)), with Q low outside of the data, but not below its return",
        about="Cal-QL: CQL whose values are fit to go on with online, by one actor.",
        source="Nakamoto 2023",
        advice="Before own episodes: CQL's values are too low to begin with, and it "
        "first unlearns. Without own episodes take CQL. Where returns are far above 0, "
        "where critics begin, nothing is held down until values have risen, and the "
        "actor goes to its bounds and may stay there: `bound_penalty` keeps it "
        "away, as it did on Hopper.",
        departs="As CQL: the target takes one action of the target actors with noise, "
        "and actors follow the first critic, where the source's code takes the best of "
        "ten actions and the lower critic. What the data's policy is worth is taken "
        "from the returns of its own episodes, as in the source, but of none that was "
        "cut off: those bound nothing, 38 % of the steps of `quiet-zone-noisy`.",
        learner=Imported("marl_mm.algorithms.cal_ql:CalQl"),
        presets={TUNED: CalQlConfig()},
    ),
)
ALGORITHMS.add(
    "ma-cal-ql",
    Algorithm(
        title="MA-Cal-QL",
        loss="-Q_1(s, (pi_i(o_i), a_-i)), with Q low where one agent leaves the data, "
        "but not below its return",
        about="Cal-QL for teams: CFCQL whose values are fit to go on with online.",
        source="Nakamoto 2023 and Shao 2023; put together by us",
        advice="As Cal-QL, where each agent must act on what it sees itself.",
        departs="As CFCQL; the bound is Cal-QL's.",
        learner=Imported("marl_mm.algorithms.cal_ql:MaCalQl"),
        presets={TUNED: CalQlConfig()},
    ),
)
