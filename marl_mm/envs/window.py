"""A wall across the way, and the slanted window in it that the finger tips pass."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.load import check_reach
from marl_mm.errors import UsageError
from marl_mm.layout import Entry
from marl_mm.sim.scene import AMBER, YELLOW, Mark

GATE = (
    *(Entry(f"gate_{axis}", "m") for axis in "xyz"),
    Entry("gate_slope", "1", -1.0, 1.0),
)
"""Middle of the window on the wall's near side, world frame, and its way aside per way
ahead through the wall."""

DISTANCE = Entry("gate_distance", "m")
"""Distance along x from the end-effector to the wall's near side; negative beyond."""

AIM = 0.01
"""Distance at which the script is at the point before the window [m]."""

FINGER = 0.02
"""Gap drawn between the window of the finger tips' middle and the wall [m]."""

OVER_BASE = 0.37
"""Height from which the wall is drawn [m]: the base is 0.352 high."""

LINTEL = 0.01
"""Height of the lintel that is drawn over the window [m]."""


class Window(NamedTuple):
    """Window of an episode, as the entries of the state."""

    x: float
    """Side of the wall that faces the start, world [m]."""

    y: float
    """Middle of the window there, world [m]."""

    z: float
    """Middle of its height, world [m]."""

    slope: float
    """Way that the middle moves along y for each metre along x [1]."""

    def error(self, hand_w: np.ndarray, thickness: float) -> float:
        """Largest distance along y or z from the window's middle within the wall [m].

        Args:
            hand_w: Positions of the hand, shape (n, 3) [m].
            thickness: Way through the wall [m].
        """
        x, y, z = hand_w.T
        ahead = x - self.x
        within = (ahead > 0) & (ahead < thickness)
        aside = np.abs(y - self.y - self.slope * ahead)
        error = np.maximum(aside, np.abs(z - self.z))[within]
        return float(error.max(initial=0.0))

    def walls(self, thickness: float, clearance: float) -> list[Mark]:
        """Drawings of the wall around the window, in slices.

        It hangs above the base, which passes below. The lintel is drawn thin, as the
        hand above the finger tips passes through it.

        Args:
            thickness: Way through the wall [m].
            clearance: Half width and half height of the window [m].
        """
        count, wide, half = 8, 0.3, clearance + FINGER
        deep, (low, high) = thickness / count, (self.z - half, self.z + half)
        foot = min(OVER_BASE, low - LINTEL)
        beside, tall = half + wide / 2, high - foot
        parts = [  # aside and height of the middle, width, height
            (beside, foot + tall / 2, wide, tall, YELLOW),
            (-beside, foot + tall / 2, wide, tall, YELLOW),
            (0.0, (foot + low) / 2, 2 * half, low - foot, YELLOW),
            (0.0, high + LINTEL / 2, 2 * half, LINTEL, AMBER),
        ]
        return [
            Mark(
                (float(self.x + ahead), float(self.y + self.slope * ahead + aside), z),
                (deep, width, height),
                color,
            )
            for ahead in (np.arange(count) + 0.5) * deep
            for aside, z, width, height, color in parts
        ]

    def way(self, hand: np.ndarray, step: float) -> np.ndarray:
        """The script's next displacement of the hand to the window or within it.

        Args:
            hand: Position of the hand before or in the wall, shape (3,) [m].
            step: Way ahead in a step [m].
        """
        middle, along = self._line()
        ahead = hand[0] - self.x
        if ahead > -2 * AIM and np.abs(hand - middle - ahead * along).max() < AIM:
            return np.asarray(middle + (ahead + step) * along - hand)
        return np.asarray(middle - AIM * along - hand)

    def way_back(self, hand: np.ndarray, step: float, thickness: float) -> np.ndarray:
        """The script's next displacement of the hand to the far side, or back.

        Args:
            hand: Position of the hand behind or in the wall, shape (3,) [m].
            step: Way back in a step [m].
            thickness: Way through the wall [m].
        """
        middle, along = self._line()
        ahead, behind = hand[0] - self.x, thickness + AIM
        on_way = np.abs(hand - middle - ahead * along).max() < AIM
        if on_way and ahead < behind + AIM:
            return np.asarray(middle + (ahead - step) * along - hand)
        return np.asarray(middle + behind * along - hand)

    def _line(self) -> tuple[np.ndarray, np.ndarray]:
        """Middle on the near side, and the way aside per way ahead, shape (3,) each."""
        return np.array([self.x, self.y, self.z]), np.array([1.0, self.slope, 0.0])


@dataclass(frozen=True, kw_only=True)
class WallConfig:
    """Intervals of the wall and its window, which the seed draws.

    Only the finger tips are held against the window: the base passes below the wall,
    and the arm's last links above it, through the lintel of pictures. Aside and above
    the wall has no end; pictures show a part of it.
    """

    x: Interval
    """Interval of x of the wall's near side, world [m]."""

    thickness: float = 0.2
    """Way through the wall along x [m]."""

    y: Interval = (-0.05, 0.05)
    """Interval of y of the window's middle at the near side, world [m]."""

    z: Interval = (0.57, 0.63)
    """Interval of z of the window's middle, world [m]."""

    slope: Interval = (0.5, 0.8)
    """Interval of the window's way aside per way ahead, to either side."""

    clearance: float = 0.025
    """Half width and half height of the window, for the finger tips [m]."""

    def __post_init__(self) -> None:
        check_intervals(self, "x", "y", "z", "slope", of="wall.")
        check_positive(self, "thickness", "clearance", of="wall.")
        low, high = self.slope
        if not 0.0 <= low <= high <= 1.0:
            raise UsageError(
                f"wall.slope is {low:g} to {high:g}, expected within 0 to 1: no step "
                "goes further aside than ahead"
            )
        aside = high * self.thickness
        check_reach(
            "with its slant, wall.", (self.y[0] - aside, self.y[1] + aside), self.z
        )

    @property
    def end(self) -> float:
        """Largest x of the wall's far side, world [m]."""
        return self.x[1] + self.thickness

    def draw(self, rng: np.random.Generator) -> Window:
        """Draw a window."""
        intervals = self.x, self.y, self.z, self.slope
        x, y, z, slope = (rng.uniform(*interval) for interval in intervals)
        return Window(x, y, z, slope if rng.random() < 0.5 else -slope)
