"""What the controller knows of the mass in the hand.

The joints' torques tell it: what they push beyond what the robot's own motion needs
moves the load. Along y = J' (a + g), the torques per kilogram in the hand, the load's
mass goes towards what explains the rest best, as a momentum observer would have it.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from marl_mm.control.config import Knowledge
from marl_mm.robot.model import GRAVITY, ModelTerms, RobotModel, RobotState

SETTLING = 0.25
"""Time constant of the estimate [s]."""

MOST = 10.0
"""Of the estimate [kg]: far beyond what the arm carries (3 kg, Franka data sheet)."""

_UP = np.array([0.0, 0.0, GRAVITY])


class Payload:
    """Keeps the load in a robot's model.

    Args:
        model: The controller's; its hand gets heavier.
        knowledge: Where the mass is from.
        rate: Ticks per second.
    """

    def __init__(self, model: RobotModel, knowledge: Knowledge, rate: float) -> None:
        self._model, self._knowledge, self._rate = model, knowledge, rate
        self.release()

    @property
    def mass(self) -> float:
        """In the model [kg]."""
        return self._mass

    def hold(self, mass: float, size: tuple[float, float, float]) -> None:
        """Something is in the hand from now on.

        Args:
            mass: What it weighs [kg].
            size: Of the cuboid whose inertia it has [m].
        """
        self._held, self._size, self._true = True, size, mass
        self._set(mass if self._knowledge == "given" else 0.0)

    @contextmanager
    def revealed(self) -> Iterator[None]:
        """Have the load in the model as it is, for those who judge the controller."""
        self._model.carry(self._true, self._size)
        try:
            yield
        finally:
            self._model.carry(self._mass, self._size)

    def release(self) -> None:
        """The hand is empty."""
        self._held, self._size, self._true = False, (0.05, 0.05, 0.05), 0.0
        self._set(0.0)

    def learn(
        self,
        before: RobotState,
        terms: ModelTerms,
        torque: np.ndarray,
        after: RobotState,
    ) -> None:
        """Take in a tick.

        Args:
            before: State at its beginning.
            terms: The model there, with the load as known.
            torque: Of the arm joints during the tick, shape (7,) [N m].
            after: State at its end.
        """
        if not self._held or self._knowledge != "estimated":
            return
        change = (after.v - before.v) * self._rate
        unexplained = torque - terms.mass_matrix[3:] @ change - terms.nonlinear[3:]
        jacobian = terms.jacobian[:3]
        acceleration = jacobian @ change + terms.bias_acceleration[:3] + _UP
        per_kilogram = jacobian[:, 3:].T @ acceleration
        missing = per_kilogram @ unexplained / max(per_kilogram @ per_kilogram, 1e-6)
        mass = self._mass + missing / (SETTLING * self._rate)
        self._set(float(np.clip(mass, 0.0, MOST)))

    def _set(self, mass: float) -> None:
        self._mass = mass
        self._model.carry(mass, self._size)
