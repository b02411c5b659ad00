"""Random abuse in closed loop: how far each limit is passed, and what fails.

Targets jump every second anywhere within ten times what an action may ask, alphas jump
with them and favour the ends: the robot is driven into its limits all the time. What is
reported is what the simulator shows, tick by tick, not what the QP promised.
"""

from dataclasses import dataclass, field

import numpy as np

from marl_mm.control.limits import WHEEL_ARM
from marl_mm.envs.drive import Tick
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ACTUATED
from marl_mm.sim.config import RATE

REACH = 10.0
"""Targets lie this many actions away."""

EPISODE_STEPS = 25
"""Steps until the robot starts anew."""


@dataclass
class Watcher:
    """The largest excess over each limit seen so far; negative where it was kept."""

    limits: RobotLimits
    keep_out: float
    worst: dict[str, float] = field(default_factory=dict)
    _last: np.ndarray | None = None

    def begin(self) -> None:
        """Forget the last tick: the robot starts anew."""
        self._last = None

    def __call__(self, tick: Tick) -> None:
        """Compare one tick's state and command with all limits."""
        limits, state, command = self.limits, tick.state, tick.command
        arm, velocity = state.q[4:], state.v[ACTUATED]
        speed = np.abs(velocity) - limits.speed
        rim = np.abs(velocity[0] + np.array([-WHEEL_ARM, WHEEL_ARM]) * velocity[1])
        excess = {
            "joint_position_rad": np.maximum(arm - limits.upper, limits.lower - arm),
            "joint_velocity_share": speed[2:] / limits.speed[2:],
            "joint_torque_share": np.abs(command.torque) / limits.torque - 1,
            "base_speed_m_s": speed[:1],
            "base_yaw_rate_rad_s": speed[1:2],
            "wheel_speed_share": rim / (limits.wheel_speed * WHEEL_RADIUS) - 1,
            "commanded_acceleration_share": np.abs(command.acceleration)
            / limits.acceleration
            - 1,
        }
        if self._last is not None:
            measured = np.abs(velocity - self._last) * RATE
            share = measured / limits.acceleration - 1
            excess["measured_joint_acceleration_share"] = share[2:]
            excess["measured_base_acceleration_share"] = share[:2]
        self._last = velocity
        for name, values in excess.items():
            self.see(name, float(values.max()))

    def see(self, name: str, excess: float) -> None:
        """Keep the largest excess over a limit."""
        self.worst[name] = max(self.worst.get(name, -np.inf), excess)
