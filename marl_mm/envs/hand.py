"""The hand with a block: grasp, the controller's knowledge of the load, failures."""

import numpy as np

from marl_mm.control.config import Knowledge
from marl_mm.control.payload import Payload
from marl_mm.envs.terms import length
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState
from marl_mm.sim.config import RATE
from marl_mm.sim.scene import Scene
from marl_mm.sim.world import Handling, Touches

SLIPPED = 0.03
"""Distance by which a held block's centre may move between the pads, in world axes
[m]. Beyond it the block is lost: dropped, unless it is back on its stand."""

EMPTY = 0.9
"""Share of the block's edge: pads that come closer have missed the block."""

LOOK_EVERY = 8
"""Number of ticks between looks at contacts."""

CLEAR = 0.01
"""Gap under a block that is clear of its stand [m]."""


class Hand:
    """The hand of a robot with a block, in one episode.

    Args:
        handling: Gripper and block in the simulator.
        model: Model of the controller.
        scene: Scene with the block.
        knowledge: Source of the load's mass for the controller.
    """

    def __init__(
        self,
        handling: Handling,
        model: RobotModel,
        scene: Scene,
        knowledge: Knowledge,
    ) -> None:
        self._handling, self._scene = handling, scene
        self._ticks = 0
        self._weld = scene.grasp == "weld"
        self._closing = False
        self.payload = Payload(model, knowledge, RATE)
        self.held = False
        """Whether the hand holds the block."""

        self.clear_ticks = 0
        """Number of ticks for which a held block has been clear of its stand."""

        self.failure = ""
        """Reason of the first failure; empty without one."""

    def grip(self, close: bool) -> None:
        """Close or open the gripper; a held block is lost when it opens."""
        if not close and self.held:
            self._lose()
        if close:
            self._handling.close_gripper()
        else:
            self._handling.open_gripper()
        self._closing = close

    def lose_reach(self) -> None:
        """Fail, as the block is where the hand cannot take it."""
        self.fail("the block is out of reach")

    def fail(self, reason: str) -> None:
        """Record a failure; the first one counts."""
        self.failure = self.failure or reason

    def take(self, grasp_w: np.ndarray) -> None:
        """Hold the block that is between the fingers.

        Args:
            grasp_w: Grasp point, world frame, shape (3,) [m].
        """
        self.grip(True)
        if self._weld:
            self._handling.weld()
        else:
            self._handling.squeeze()
        self._offset = self._handling.block_w()[0] - grasp_w
        block = self._scene.block
        across, along, up = block.size  # fingers close along y of the grasp frame
        self.payload.hold(block.mass, (along, across, up))
        self.held = True

    def feel(
        self,
        before: RobotState,
        terms: ModelTerms,
        torque: np.ndarray,
        after: RobotState,
    ) -> None:
        """Process a tick of the robot; see ``Payload.learn``."""
        self.payload.learn(before, terms, torque, after)
        self.wait(1, terms.position_w)

    @property
    def ticks_to_look(self) -> int:
        """Number of ticks until the next look at contacts, 1 or more."""
        return LOOK_EVERY - self._ticks % LOOK_EVERY

    def wait(self, ticks: int, grasp_w: np.ndarray) -> None:
        """Count ticks up to the next look, and look then.

        Args:
            ticks: Number of ticks, at most ``ticks_to_look``.
            grasp_w: Grasp point before the last of them, shape (3,) [m].
        """
        self._ticks += ticks
        if self._ticks % LOOK_EVERY == 0 and not self.failure:
            self._look(grasp_w)

    def _look(self, grasp_w: np.ndarray) -> None:
        touches = self._handling.touches()
        if touches.collision:
            self.fail(f"collision of {touches.collision}")
        elif touches.ground and self.held:
            self.fail("collision of the block and the ground")
        block_w, _ = self._handling.block_w()
        if self.held:
            way = block_w - grasp_w - self._offset
            if not self._weld and length(way) > SLIPPED:
                self._lose()
        elif self._closing:
            self._close_around(touches, grasp_w)
        self.clear_ticks += LOOK_EVERY
        if not (self.held and self._is_clear(block_w, touches)):
            self.clear_ticks = 0
        stand = self._scene.stand_size
        if not self.held and stand is not None and block_w[2] < stand[2]:
            self.lose_reach()

    def _is_clear(self, block_w: np.ndarray, touches: Touches) -> bool:
        """Whether the block does not touch its stand, and is above or beside it."""
        scene, stand = self._scene, self._scene.stand_size
        if stand is None:
            return True
        under = block_w[2] - scene.block.size[2] / 2 - stand[2]
        aside = np.abs(block_w[:2] - scene.position_w[:2])
        widths = np.array(stand[:2]) + np.array(scene.block.size[:2])
        beside = (aside > widths / 2).any()
        return bool((under > CLEAR or beside) and not touches.stand)

    def _close_around(self, touches: Touches, grasp_w: np.ndarray) -> None:
        if self._handling.opening() < EMPTY * self._scene.block.size[0]:
            self.fail("missed grasp")
        elif touches.fingers == 2:
            self.take(grasp_w)

    def _lose(self) -> None:
        """Lose the held block; it is dropped if it is clear of its stand."""
        self.held = False
        if self._weld:
            self._handling.unweld()
        self.payload.release()
        block_w, _ = self._handling.block_w()
        if self._is_clear(block_w, self._handling.touches()):
            self.fail("dropped")
