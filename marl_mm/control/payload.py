"""Estimate of the mass in the hand, from the torques of the joints.

Torques beyond those of the robot's own motion move the load. Along y = J' (a + g), the
torques per kilogram in the hand, the estimate goes towards the mass that explains them
best, as in a momentum observer.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from marl_mm.control.config import HEAVIEST, Knowledge
from marl_mm.jit import jit, on_stack
from marl_mm.robot.model import GRAVITY, ModelTerms, RobotModel, RobotState
from marl_mm.robot.planar import PlanarModel

SETTLING = 0.25
"""Time constant of the estimate [s]."""

_velocity, _position = on_stack(10), on_stack(3)
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

    @property
    def true_mass(self) -> float:
        """Mass of the load in the hand [kg]."""
        return self._true

    @property
    def size(self) -> tuple[float, float, float]:
        """Edges of the cuboid in the hand, along the grasp frame's axes [m]."""
        return self._size

    @property
    def learns(self) -> bool:
        """Whether the mass is being estimated."""
        return self._held and self._knowledge == "estimated"

    def hold(self, mass: float, size: tuple[float, float, float]) -> None:
        """Take a load into the hand.

        Args:
            mass: True mass [kg].
            size: Edges of the cuboid whose inertia it has, along the grasp frame's axes
                [m].
        """
        self._held, self._size, self._true = True, size, mass
        self.count(mass if self._knowledge == "given" else 0.0)

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
        self.count(0.0)

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
        if not self.learns:
            return
        if isinstance(self._model, PlanarModel):  # as a compiled step, to the last bit
            with_terms = before.v, tuple(terms), torque, after.v
            self.count(learned(self._mass, self._rate, *with_terms))
            return
        change = (after.v - before.v) * self._rate
        unexplained = torque - terms.mass_matrix[3:] @ change - terms.nonlinear[3:]
        jacobian = terms.jacobian[:3]
        acceleration = jacobian @ change + terms.bias_acceleration[:3] + _UP
        per_kilogram = jacobian[:, 3:].T @ acceleration
        missing = per_kilogram @ unexplained / max(per_kilogram @ per_kilogram, 1e-6)
        mass = self._mass + missing / (SETTLING * self._rate)
        self.count(float(np.clip(mass, 0.0, HEAVIEST)))

    def count(self, mass: float) -> None:
        """Have this mass in the model from now on [kg]."""
        self._mass = mass
        self._model.carry(mass, self._size)


@jit
def learned(
    mass: float,
    rate: float,
    before: np.ndarray,
    terms: tuple[Any, ...],
    torque: np.ndarray,
    after: np.ndarray,
) -> float:
    """The estimate of ``Payload.learn`` after a tick [kg].

    Args:
        mass: Estimate before it [kg].
        rate: Ticks per second.
        before: Velocity at its beginning, shape (10,).
        terms: ``ModelTerms`` at its beginning.
        torque: Torques of the arm joints during it, shape (7,) [N m].
        after: Velocity at its end, shape (10,).
    """
    terms_ = ModelTerms(*terms)
    jacobian, matrix = terms_.jacobian, terms_.mass_matrix
    change = _velocity()
    for j in range(10):
        change[j] = (after[j] - before[j]) * rate
    acceleration = _position()
    for k in range(3):
        acceleration[k] = terms_.bias_acceleration[k] + (GRAVITY if k == 2 else 0.0)
        for j in range(10):
            acceleration[k] += jacobian[k, j] * change[j]
    along = square = 0.0
    for i in range(7):
        unexplained = torque[i] - terms_.nonlinear[3 + i]
        for j in range(10):
            unexplained -= matrix[3 + i, j] * change[j]
        per_kilogram = 0.0
        for k in range(3):
            per_kilogram += jacobian[k, 3 + i] * acceleration[k]
        along += per_kilogram * unexplained
        square += per_kilogram * per_kilogram
    mass += along / max(square, 1e-6) / (SETTLING * rate)
    return min(max(mass, 0.0), HEAVIEST)
