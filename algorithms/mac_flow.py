"""MAC-Flow (Lee 2025): FQL with a one-step actor for each agent.

Losses: see ``fql``. The teacher is a flow of the joint action; agent i's actor knows
its own observation and its own part of the noise. The loss is therefore least at the
mean of the teacher's action over all that agent i does not know, the others' noise
included.

Ours: twin critics of the joint state and action, where the source averages critics of
each agent's own observation and action, as the individual-global-max condition asks;
and what FQL has of ours.
"""

from typing import ClassVar

from marl_mm.algorithms.fql import Fql


class MacFlow(Fql):
    """Learns decentralised one-step actors; see ``Fql``."""

    name: ClassVar[str] = "mac-flow"
    team = True
