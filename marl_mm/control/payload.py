"""Estimate of the mass in the hand, from the torques of the joints.

Torques beyond those of the robot's own motion move the load. Along y = J' (a + g), the
torques per kilogram in the hand, the estimate goes towards the mass that explains them
best, as in a momentum observer.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from marl_mm.control.config import Knowledge
from marl_mm.robot.model import GRAVITY, ModelTerms, RobotModel, RobotState

SETTLING = 0.25
"""Time constant of the estimate [s]."""

MOST = 10.0
"""Largest estimate [kg]: far beyond what the arm carries (3 kg, Franka data sheet)."""

_UP = np.array([0.0, 0.0, GRAVITY])


class Payload:
    """Keeps the load in a robot's model.

    Args:
        model: Model of the controller, whose hand gets heavier.
        knowledge: Source of the mass.
        rate: Ticks per second.
    """

    def __init__(self, model: RobotModel, knowledge: Knowledge, rate: float) -> None:
        self._model, self._knowledge, self._rate = model, knowledge, rate
        self.release()

    @property
    def mass(self) -> float:
        """Mass of the load in the model [kg]."""
        return self._mass

    def hold(self, mass: float, size: tuple[float, float, float]) -> None:
        """Take a load into the hand.

        Args:
            mass: True mass [kg].
            size: Edges of the cuboid whose inertia it has [m].
        """
        self._held, self._size, self._true = True, size, mass
        self._set(mass if self._knowledge == "given" else 0.0)

    @contextmanager
    def revealed(self) -> Iterator[None]:
        """Have the true load in the model, to judge the controller by."""
        self._model.carry(self._true, self._size)
        try:
            yield
        finally:
            self._model.carry(self._mass, self._size)

    def release(self) -> None:
        """Empty the hand."""
        self._held, self._size, self._true = False, (0.05, 0.05, 0.05), 0.0
        self._set(0.0)

    def learn(
        self,
        before: RobotState,
        terms: ModelTerms,
        torque: np.ndarray,
        after: RobotState,
    ) -> None:
        """Update the estimate by one tick.

        Args:
            before: State at its beginning.
            terms: Model at that state, with the load as estimated.
            torque: Torques of the arm joints during the tick, shape (7,) [N m].
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
