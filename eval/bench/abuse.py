"""Random abuse in closed loop: how far each limit is passed, and what fails.

Targets jump every second anywhere within ten times what an action may ask, alphas jump
with them and favour the ends: the robot is driven into its limits all the time. What is
reported is what the simulator shows, tick by tick, not what the QP promised.
"""

from time import perf_counter
from typing import Any

import numpy as np

from marl_mm.control.limits import WHEEL_ARM
from marl_mm.control.records import Command
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Drive, Tick
from marl_mm.envs.task import Task
from marl_mm.progress import Advance, silent
from marl_mm.robot.description import WHEEL_RADIUS, RobotConfig
from marl_mm.robot.model import ACTUATED, RobotModel
from marl_mm.sim.config import RATE

REACH = 10.0
"""Targets lie up to this many actions away, per axis."""

SETTLING = 3
"""Ticks after a reset in which contacts and the fingers' motors settle."""


class Watcher:
    """The largest excess over each limit seen so far; negative where it was kept.

    Args:
        drive: Drive of the watched robot.
        robot: Mass properties of the robot.
        keep_out: Plane of the controller's limits [m].
    """

    def __init__(self, drive: Drive, robot: RobotConfig, keep_out: float) -> None:
        self._drive, self._keep_out = drive, keep_out
        self._model = RobotModel(robot)  # the drive's own is at the next state already
        self.worst: dict[str, float] = {}
        self.begin()

    def begin(self) -> None:
        """Forget the last tick: the robot starts anew."""
        self._last: np.ndarray | None = None
        self._ticks = 0

    def __call__(self, tick: Tick) -> None:
        """Compare one tick's state and command with all limits."""
        limits, state, command = self._drive.limits, tick.state, tick.command
        arm, velocity = state.q[4:], state.v[ACTUATED]
        speed = np.abs(velocity) / limits.speed - 1
        rim = np.abs(velocity[0] + np.array([-WHEEL_ARM, WHEEL_ARM]) * velocity[1])
        commanded = np.abs(command.acceleration) / limits.acceleration - 1
        terms = self._model.evaluate(state)
        # What u takes, before the command is clipped to what the joint can give.
        inertia = terms.mass_matrix[3:, ACTUATED]
        torque = inertia @ command.acceleration + terms.nonlinear[3:]
        ahead = state.q[2:4] @ (terms.position_w[:2] - state.q[:2])
        excess = {
            "keep_out_m": np.array([self._keep_out - ahead]),
            "joint_position_rad": np.maximum(arm - limits.upper, limits.lower - arm),
            "joint_velocity_share": speed[2:],
            "joint_torque_share": np.abs(torque) / limits.torque - 1,
            "base_speed_share": speed[:1],
            "base_yaw_rate_share": speed[1:2],
            "wheel_speed_share": rim / (limits.wheel_speed * WHEEL_RADIUS) - 1,
            "commanded_acceleration_share": commanded,
        }
        if self._last is not None:
            measured = np.abs(velocity - self._last) * RATE / limits.acceleration - 1
            excess["measured_joint_acceleration_share"] = measured[2:]
            excess["measured_base_acceleration_share"] = measured[:2]
        self._ticks += 1
        if self._ticks > SETTLING:
            self._last = velocity
        for name, values in excess.items():
            self._see(name, float(values.max()))

    def _see(self, name: str, excess: float) -> None:
        self.worst[name] = max(self.worst.get(name, -np.inf), excess)


def abuse(
    config: Task, ticks: int, seed: int, advance: Advance = silent
) -> dict[str, Any]:
    """Run at least ``ticks`` ticks of abuse and report.

    Args:
        config: Task whose controller is abused.
        ticks: Number of ticks of 1/240 s.
        seed: Seed of targets and alphas.
        advance: Called with the number of finished ticks.

    Returns:
        ``worst_excess``, the largest excess over each limit (a share of it, or in its
        unit; negative: kept), counts of levels, QPs, failures and safe commands,
        extremes of stability, and the longest tick of the controller [us].
    """
    core = EpisodeCore(config)
    drive = core.drive
    watcher = Watcher(drive, config.robot, config.controller.limits.keep_out)
    rng = np.random.default_rng(seed)
    done = levels = qps = 0
    reasons: dict[str, int] = {}
    longest = 0.0
    along = drive.controller.along

    def timed_along(*order: Any) -> Any:
        command_at = along(*order)

        def timed(*arguments: Any) -> Command:
            nonlocal longest
            begin = perf_counter()
            command = command_at(*arguments)
            longest = max(longest, perf_counter() - begin)
            return command

        return timed

    setattr(drive.controller, "along", timed_along)  # noqa: B010, else mypy complains

    def watch(tick: Tick) -> None:
        nonlocal levels, qps
        command = tick.command
        levels, qps = levels + command.levels, qps + command.qps
        if command.reason is not None:
            reasons[command.reason] = reasons.get(command.reason, 0) + 1
        watcher(tick)

    infos: list[dict[str, Any]] = []
    try:
        while done < ticks:
            if len(infos) % config.max_steps == 0:
                core.reset(rng)
                watcher.begin()
                if not infos:  # compiles, or loads what was compiled
                    core.step(np.zeros(4))
                    core.reset(rng)
                    longest = 0.0
            action = np.empty(4)
            action[:3] = REACH * rng.uniform(-1, 1, 3)
            action[3] = rng.choice([0.0, 1.0, rng.uniform()])
            infos.append(core.push(action, watch).info)
            done += config.ticks_per_step
            advance(config.ticks_per_step, f"{sum(reasons.values())} failed levels")
    finally:
        core.close()
    return {
        "ticks": done,
        "worst_excess": dict(sorted(watcher.worst.items())),
        "levels": levels,
        "qps": qps,
        "failed_levels": sum(info["qp_failures"] for info in infos),
        "reasons": reasons,
        "safe_ticks": sum(info["safe_ticks"] for info in infos),
        "least_zmp_margin_m": min(info["zmp_margin"] for info in infos),
        "largest_tilt_rad": max(info["tilt"] for info in infos),
        "largest_wheel_slip_m_s": max(info["wheel_slip"] for info in infos),
        "largest_model_ee_error_m": max(info["model_ee_error"] for info in infos),
        "longest_controller_tick_us": 1e6 * longest,
    }
