"""Rows of the limits on u: where each kind begins, and what each row limits.

Torque rows come first (7), then one box row per variable (9), then the keep-out plane,
the rim speed of both drive wheels, the ground's forces on them and, where
``LimitConfig.zmp`` asks for it, the zero-moment point at the six edges of the support
polygon. ``compiled/assembly.py`` fills them, ``reference/limits.py`` explains them.
"""

from marl_mm.control.config import LimitConfig
from marl_mm.robot.description import WHEEL_SEPARATION
from marl_mm.robot.support import SUPPORT_B

TORQUE, BOX, KEEP_OUT, WHEELS, TRACTION, ZMP = 0, 7, 16, 17, 19, 22
"""First row of each kind."""

TORQUE_ROWS = slice(TORQUE, BOX)
BOX_ROWS = slice(BOX, KEEP_OUT)
WHEEL_ROWS = slice(WHEELS, TRACTION)
TRACTION_ROWS = slice(TRACTION, ZMP)
ZMP_ROWS = slice(ZMP, ZMP + len(SUPPORT_B))

ROWS = ZMP
"""Number of rows without those of the zero-moment point."""

LIMIT_NAMES = (
    *(f"torque of arm joint {i + 1}" for i in range(7)),
    "base acceleration",
    "base yaw acceleration",
    *(f"acceleration of arm joint {i + 1}" for i in range(7)),
    "keep-out plane",
    "speed of the left wheel",
    "speed of the right wheel",
    "traction of the left wheel",
    "traction of the right wheel",
    "side force on the wheels",
    *(f"zero-moment point at edge {i + 1}" for i in range(len(SUPPORT_B))),
)
"""Limited quantity of each row."""

LEAST_WIDTH = 2e-3
"""Least width of a box row [m/s^2], [rad/s^2]."""

UNBOUNDED = 1e9
"""Value of a bound that does not bind."""

WHEEL_ARM = WHEEL_SEPARATION / 2
"""Lever of a drive wheel: rim speed per yaw rate of the base [m]."""


def row_count(config: LimitConfig) -> int:
    """Number of rows with this config."""
    return ROWS + (len(SUPPORT_B) if config.zmp else 0)
