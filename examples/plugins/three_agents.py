"""Reach by three agents: the hand along the ground, its height, and the balance."""

from dataclasses import dataclass, replace

from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, names
from marl_mm.envs.registry import register_task
from marl_mm.envs.tasks.reach import LAYOUT, Reach
from marl_mm.layout import Agent

SEEN = names(*HAND, *BASE)
GROUND, HEIGHT = names(*GOAL[:2]), names(GOAL[2])

TEAM = (
    Agent("lift", (*SEEN, *HEIGHT), names(DELTA[2])),
    Agent("ground", (*SEEN, *GROUND), names(*DELTA[:2])),
    Agent("balance", (*SEEN, MODE.name), names(ALPHA)),
)
"""Three agents, deliberately not in the order of the action's entries."""


@dataclass(frozen=True, kw_only=True)
class ThreeAgents(Reach):
    """Reach by three agents."""

    about = "Bring the end-effector to a goal, by three agents."
    layout = replace(LAYOUT, team=TEAM)


register_task("ThreeReach-v0", ThreeAgents())
