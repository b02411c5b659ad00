"""Cal-QL (Nakamoto 2023): CQL whose values are not below what the data's policy gets.

As CFCQL and CQL, see ``cfcql``, but in the conservative term the value of an action
near the policy's counts as max(Q_j(s, u), V(s)), where V(s) is the discounted return of
the episode from that step on. So the term does not push values of what the
policy does below the data's returns, and the first episodes online do not have to
correct them; values of uniform actions have no bound, as in the source. The return of
an episode that was cut off is not known, and bounds nothing.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.cal_ql_config import CalQlConfig
from marl_mm.algorithms.cfcql import Cfcql
from marl_mm.algorithms.offline_batches import OfflineBatch


class CalQl(Cfcql):
    """One actor and calibrated twin critics; see ``Cfcql``."""

    name: ClassVar[str] = "cal-ql"
    team = False
    config: CalQlConfig

    def _near(self, values: torch.Tensor, batch: OfflineBatch) -> torch.Tensor:
        """Values of actions near the policy's, no lower than the episode's return."""
        least = batch.rest[:, None, None, None, : values.shape[-1]]
        return values.maximum(least)


class MaCalQl(CalQl):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-cal-ql"
    team = True
