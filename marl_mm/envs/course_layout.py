"""What the agents of Course see and set."""

from marl_mm.envs.cruise import ALPHA, BASE, DELTA, HAND, MODE, names
from marl_mm.envs.tasks.grasp import BLOCK, GRIP, HELD, OPENING, STAND
from marl_mm.envs.window import DISTANCE, GATE
from marl_mm.layout import Agent, Entry, Layout

STAGES = ("take", "cross", "pass", "deliver", "return")
"""Names of the sub-goals, in order."""

ZONE = (Entry("zone_near", "m"), Entry("zone_far", "m"))
"""Where the base enters and leaves the quiet zone, x in the world."""

BIN = tuple(Entry(f"bin_{axis}", "m") for axis in "xyz")
"""Place over the bin at which the block is let go, world frame."""

STAGE = Entry("stage", "1", 0.0, len(STAGES))
"""Number of sub-goals reached."""

WANTED = Entry("stages_wanted", "1", 0.0)
"""Number that ends the episode."""

LAYOUT = Layout(
    (
        *(*HAND, *BASE, MODE, OPENING, HELD, *BLOCK, *STAND),
        *(*ZONE, *GATE, DISTANCE, *BIN, STAGE, WANTED),
    ),
    (*DELTA, GRIP, ALPHA),
    (
        Agent(
            "end_effector",
            names(*HAND, *BASE, OPENING, HELD, *BLOCK, *STAND, *GATE, *BIN, STAGE),
            names(*DELTA, GRIP),
        ),
        Agent("balance", names(*BASE, MODE, *ZONE, DISTANCE, STAGE), names(ALPHA)),
    ),
    compared=names(STAGE),
    desired=names(WANTED),
)
"""Layout of Course: one agent sees block, window and bin, the other one the zone and
how far the wall is. Both see how far the team has come."""
