"""The same tasks as one weighted QP by Pink: what a user of a library would write.

Pink solves differential inverse kinematics: velocities, no torques, no strict
priorities, and here a base that may slide sideways. It is here for its cost.
"""

from typing import Any

import numpy as np
import pinocchio as pin
from pink import Configuration, solve_ik
from pink.limits import VelocityLimit
from pink.tasks import FrameTask, PostureTask

from marl_mm.control.records import Reference
from marl_mm.robot.model import RobotState
from marl_mm.robot.names import GRASP_FRAME
from marl_mm.sim.config import RATE


class PinkReference:
    """Weighted inverse kinematics of one robot.

    Args:
        model: Pinocchio's.
    """

    def __init__(self, model: Any) -> None:
        self._model, self._data = model, model.createData()
        self._hand = FrameTask(GRASP_FRAME, position_cost=10.0, orientation_cost=3.0)
        self._base = FrameTask("base_link", position_cost=1.0, orientation_cost=1.0)
        self._posture = PostureTask(cost=0.01)
        self._limits = [VelocityLimit(model)]

    def solve(self, state: RobotState, reference: Reference) -> np.ndarray:
        """Velocity, shape (10,)."""
        configuration = Configuration(self._model, self._data, state.q)
        self._hand.set_target(pin.SE3(reference.ee_rotation_w, reference.ee_position_w))
        x, y = reference.base_position_w
        heading = reference.base_heading
        self._base.set_target(
            pin.SE3(pin.utils.rotate("z", heading), np.array([x, y, 0.0]))
        )
        posture = state.q.copy()
        posture[4:] = reference.posture
        self._posture.set_target(posture)
        velocity: np.ndarray = solve_ik(
            configuration,
            [self._hand, self._base, self._posture],
            1 / RATE,
            solver="daqp",
            limits=self._limits,
        )
        return velocity
