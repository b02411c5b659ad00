"""Reach under a clock: the balance agent also sees how much time is left."""

from dataclasses import dataclass, replace

from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, Values
from marl_mm.envs.tasks.reach import LAYOUT, Reach
from marl_mm.layout import Entry

TIME_LEFT = Entry("time_left", "1", 0.0, 1.0)
"""Share of the episode's steps that are left."""

_hand, _balance = LAYOUT.team


@dataclass(frozen=True, kw_only=True)
class TimedReach(Reach):
    """Reach with the time left in the balance agent's observation."""

    about = "Bring the end-effector to a goal, and see the time that is left."
    layout = replace(
        LAYOUT,
        state=(*LAYOUT.state, TIME_LEFT),
        team=(_hand, replace(_balance, sees=(*_balance.sees, TIME_LEFT.name))),
    )

    def observe(self, attempt: Attempt) -> Values:
        """Reach's state, and the time left."""
        left = 1.0 - attempt.steps / self.max_steps
        return {**super().observe(attempt), TIME_LEFT.name: left}


register_task("TimedReach-v0", TimedReach())


TEMPO = Entry("tempo", "1", 0.0, 1.0)
"""Share of the episode's steps that are over: a state of equal width."""


@dataclass(frozen=True, kw_only=True)
class PacedReach(TimedReach):
    """Reach with the time that is over in the end-effector agent's observation."""

    about = "Bring the end-effector to a goal, and see the time that is over."
    layout = replace(
        LAYOUT,
        state=(*LAYOUT.state, TEMPO),
        team=(replace(_hand, sees=(*_hand.sees, TEMPO.name)), _balance),
    )

    def observe(self, attempt: Attempt) -> Values:
        """Reach's state, and the time that is over."""
        return {
            **Reach.observe(self, attempt),
            TEMPO.name: attempt.steps / self.max_steps,
        }


register_task("PacedReach-v0", PacedReach())
