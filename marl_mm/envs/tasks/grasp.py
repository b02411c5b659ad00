"""Grasp: take a block from a stand, and lift it or carry it to a goal."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, names
from marl_mm.envs.grasping import grasping
from marl_mm.envs.load import StandConfig, in_reach
from marl_mm.envs.order import Order
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Terms, Values
from marl_mm.envs.tasks.carry import GOAL_SIZE, Carry
from marl_mm.envs.tasks.reach import Reach, steer
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.scene import Mark

OPENING = Entry("opening", "m", -0.1, 0.1)
"""Distance between the finger tips; the hand opens to 0.08."""

HELD = Entry("held", "1", 0.0, 1.0)
"""1 if the block has been held clear of its stand for long enough, else 0."""

BLOCK = tuple(Entry(f"block_{axis}", "m") for axis in "xyz")
"""Position of the block's centre, world frame."""

STAND = tuple(Entry(f"stand_{axis}", "m") for axis in "xyz")
"""Position of the middle of the stand's top, world frame."""

GRIP = Entry("grip", "1", -1.0, 1.0)
"""Command of the gripper: it closes above 0."""

LAYOUT = Layout(
    (*HAND, *BASE, MODE, OPENING, HELD, *BLOCK, *STAND, *GOAL),
    (*DELTA, GRIP, ALPHA),
    (
        Agent(
            "end_effector",
            names(*HAND, *BASE, OPENING, HELD, *BLOCK, *STAND, *GOAL),
            names(*DELTA, GRIP),
        ),
        Agent("balance", names(*HAND, *BASE, MODE, HELD), names(ALPHA)),
    ),
    compared=names(*BLOCK),
    desired=names(*GOAL),
)
"""Layout of the grasping tasks. The end-effector's agent sees the block, its stand and
the gripper's opening; both agents see whether the block is held."""


def handled(attempt: Attempt, holds: bool) -> dict[str, float]:
    """The state's entries of hand, block and stand."""
    handling = attempt.drives[0].world.handling
    block_w, _ = handling.block_w()
    seen = handling.opening(), holds, *block_w, *handling.scene.stand_w
    return dict(zip(names(OPENING, HELD, *BLOCK, *STAND), seen, strict=True))


def holds_clear(attempt: Attempt, ticks: int) -> bool:
    """Whether the block has been held, clear of its stand, for so many ticks."""
    hand = attempt.drives[0].hand
    return hand is not None and hand.held and hand.clear_ticks >= max(ticks, 1)


@dataclass(frozen=True, kw_only=True)
class Grasp(Carry):
    """The task, with goals, reward, block and stand as fields."""

    about = "Take a block from a stand and bring it to a goal."
    layout = LAYOUT
    needs: ClassVar[tuple[str, ...]] = (*Reach.needs, "held")

    load: StandConfig = field(default_factory=StandConfig)
    """Intervals of the block and its stand."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.random_start_steps:
            raise UsageError(
                f"random_start_steps is {self.random_start_steps}, expected 0: a hand "
                "that closes at random misses the block before the episode begins"
            )
        self.load.check_hold(self.max_steps * self.ticks_per_step)

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw goal, block and stand, and open the hand."""
        drawn = np.array(self._draw_goal(rng, ahead=bool(rng.random() < 0.5)))
        load = self.load
        scene = load.draw_scene(rng)
        if load.lift:
            drawn = np.array(scene.position_w)
            drawn[2] += load.lift
        attempt.goal = drawn if goal is None else goal
        goal_mark = Mark(tuple(attempt.goal.tolist()), (GOAL_SIZE,))
        self.place(attempt, (goal_mark,), scene)
        hand = attempt.drives[0].handle(scene, load.knowledge)
        hand.grip(False)
        if not in_reach(scene.position_w, travel=self.action_scale * self.max_steps):
            hand.lose_reach()

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        """Goal as in Reach; None if the block is only lifted: the seed draws it."""
        return None if self.load.lift else super().fixed_goal(index, rng)

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        """Close or open the hand, and act as in Reach."""
        hand = attempt.drives[0].hand
        if hand is not None:
            hand.grip(action[GRIP.name] > 0)
        return super().act(attempt, action)

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of Reach, and opening, block and stand."""
        return {**super().observe(attempt), **handled(attempt, self.holds(attempt))}

    def holds(self, attempt: Attempt) -> bool:
        """Whether the block has been held, clear of its stand, for long enough."""
        return holds_clear(attempt, self.load.hold_ticks)

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether the block is held within ``success_distance`` of the goal."""
        below = super().reached(achieved, desired, terms)
        return np.asarray(below & terms[HELD.name].astype(bool))

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Move over the block, down, close, up and to the goal; alpha is constant."""
        hand, block, stand, goal = (
            np.array([state[entry.name] for entry in entries])
            for entries in (HAND, BLOCK, STAND, GOAL)
        )
        way, closes = grasping(hand, block, stand, goal, state[OPENING.name])
        grip = 1.0 if closes else -1.0
        return {**steer(script.kp * way), GRIP.name: grip, ALPHA.name: script.alpha}


register_task("Grasp-v0", Grasp(max_steps=20, load=StandConfig(lift=0.1)))
register_task(
    "GraspReach-v0", Grasp(max_steps=50, load=StandConfig(failure_reward=-100.0))
)
