"""The hand at work: what it holds, what the controller knows of it, what goes wrong."""

from typing import Literal

import numpy as np

from marl_mm.control.payload import Knowledge, Payload
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState
from marl_mm.sim.config import RATE
from marl_mm.sim.handling import Handling
from marl_mm.sim.scene import Scene

Grasp = Literal["friction", "weld"]
"""How a block is held: between the pads, or fixed to the hand."""

SLIPPED = 0.03
"""A held block whose centre is this far from where it was taken is dropped [m]."""


class Hand:
    """Holds a block, in one episode.

    Args:
        handling: The simulator's side.
        model: The controller's side.
        scene: What there is to hold.
        knowledge: What the controller knows of the load.
        grasp: How a block is held.
        every: Ticks between looks at contacts.
    """

    def __init__(
        self,
        handling: Handling,
        model: RobotModel,
        scene: Scene,
        knowledge: Knowledge,
        grasp: Grasp,
        every: int,
    ) -> None:
        self._handling, self._scene, self._every = handling, scene, every
        self._weld = grasp == "weld"
        self.payload = Payload(model, knowledge, RATE)
        self.held = False
        self.failure = ""
        """What went wrong first, in words; or nothing."""

    def take(self, grasp_w: np.ndarray) -> None:
        """The block is between the fingers: hold it from now on.

        Args:
            grasp_w: Where the grasp point is, shape (3,) [m].
        """
        self._handling.close_gripper()
        if self._weld:
            self._handling.weld()
        self._offset = self._handling.block_w()[0] - grasp_w
        block = self._scene.block
        self.payload.hold(block.mass, block.size)
        self.held = True

    def feel(
        self,
        number: int,
        before: RobotState,
        terms: ModelTerms,
        torque: np.ndarray,
        after: RobotState,
    ) -> None:
        """Take in a tick; see ``Payload.learn``."""
        self.payload.learn(before, terms, torque, after)
        if number % self._every:
            return
        collision = self._handling.collision()
        if collision:
            self._fail(f"collision of {collision}")
        if self.held:
            way = self._handling.block_w()[0] - terms.position_w - self._offset
            if not self._weld and np.linalg.norm(way) > SLIPPED:
                self.held = False
                self.payload.release()
                self._fail("dropped")

    def _fail(self, reason: str) -> None:
        self.failure = self.failure or reason
