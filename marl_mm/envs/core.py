"""One episode: the shared core of the Gymnasium and the PettingZoo environment.

A step is one second: the action becomes a target for the hand and a plan for the base,
which the whole-body controller follows for 240 ticks.
"""

from typing import Any, NamedTuple

import numpy as np

from marl_mm.control.tasks.task import Reference
from marl_mm.envs.config import ReachConfig
from marl_mm.envs.drive import Drive, Motion, Watch
from marl_mm.envs.hand import OUT_OF_REACH, Hand
from marl_mm.envs.terms import goal_distance, reach_reward, reached
from marl_mm.errors import InvalidActionError, UsageError
from marl_mm.layout import ALPHA, DELTA, GRIP, HANDLING
from marl_mm.robot.model import RobotState
from marl_mm.sim.config import RATE
from marl_mm.sim.scene import Block, Scene

FAR = 1.3
"""Of a base a block can be taken no farther away than this along an axis [m]: the arm's
foot is 0.22 ahead of the base, and it reaches 0.855 (Franka data sheet)."""

HIGH = 1.4
"""No higher than this either [m]: the arm's shoulder is at 0.68."""

RENDER_MODES = ("rgb_array",)
"""Pictures; for PyBullet's window there is ``marl-mm play --gui``."""


def check_render_mode(mode: str | None) -> None:
    """Raise for a render mode that does not exist.

    Raises:
        UsageError: If it is neither None nor one of ``RENDER_MODES``.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UsageError(
            f"render_mode is {mode!r}, expected {' or '.join(RENDER_MODES)} or None"
        )


class BasePlan(NamedTuple):
    """A slow, straight cruise of the base during one step."""

    start_x: float
    """Where the base is when the step begins, world [m]."""

    advance: float
    """Signed length along x [m]; the plan lies on y = 0."""

    direction: float
    """-1 backward, 0 standing, 1 forward."""

    def points(self, ticks: int) -> np.ndarray:
        """The plan after each tick of the step, shape (ticks, 2) [m]."""
        x = self.start_x + self.advance * np.arange(1, ticks + 1) / ticks
        return np.stack([x, np.zeros(ticks)], axis=1)

    def heading(self, y: float, gain: float, limit: float) -> float:
        """Heading that steers a base at lateral offset y back to y = 0 [rad]."""
        return -self.direction * min(max(gain * y, -limit), limit)


class Step(NamedTuple):
    """What a step returns."""

    state: np.ndarray
    """Joint state, as in the task's layout."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    """Named and with units in ``marl_mm.episode.INFO``."""


class ReachCore:
    """The robot, its controller and the task.

    Args:
        config: The task.
        visual: Load meshes for rendering.
        gui: Open PyBullet's window.
    """

    def __init__(
        self, config: ReachConfig, visual: bool = False, gui: bool = False
    ) -> None:
        self.config = config
        self.drive = Drive(
            config.robot, config.simulation, config.controller, visual, gui
        )
        self._posture = np.array(config.robot.initial_joints)
        start = RobotState(np.array([0, 0, 1, 0, *self._posture]), np.zeros(10))
        self._start_w = self.drive.model.evaluate(start).position_w.copy()
        self._low, self._high = (
            np.array(config.layout.low),
            np.array(config.layout.high),
        )
        self._steps = -1

    def sample_goal(self, rng: np.random.Generator) -> np.ndarray:
        """A goal ahead or behind with equal chance, world frame, shape (3,) [m]."""
        config = self.config
        ahead = rng.random() < 0.5
        x = config.goal_x_forward if ahead else config.goal_x_backward
        return np.array(
            [rng.uniform(*axis) for axis in (x, config.goal_y, config.goal_z)]
        )

    def reset(
        self, rng: np.random.Generator, goal_w: np.ndarray | None = None
    ) -> np.ndarray:
        """Begin an episode and return the joint state.

        Args:
            rng: Draws the goal and the random start.
            goal_w: Where to go instead of a drawn goal, shape (3,) [m].
        """
        drawn = self.sample_goal(rng)
        scene = None if self.config.load is None else self._draw_load(rng)
        if scene is not None and self.config.load.lift:  # type: ignore[union-attr]
            drawn = np.array(scene.position_w)
            drawn[2] += self.config.load.lift  # type: ignore[union-attr]
        self._goal_w = drawn if goal_w is None else _checked_goal(goal_w)
        start = self.drive.model.evaluate(self.drive.reset(self._goal_w, scene))
        self._ee_rotation_w = np.ascontiguousarray(start.rotation_w).copy()
        self._ee_w = self.drive.world.grasp_position_w()
        self._alpha = self.config.initial_alpha
        self._steps = 0
        if scene is not None:
            self._handle(scene)
        for _ in range(self.config.random_start_steps):
            action = rng.uniform(self._low, self._high)
            target_w = self._ee_w + self.config.action_scale * action[DELTA]
            self._alpha = float(action[ALPHA])
            self._follow(target_w, self._plan_base(target_w), None)
        return self._joint_state()

    def step(self, action: np.ndarray, watch: Watch | None = None) -> Step:
        """Act for one second.

        Args:
            action: Entries as in the task's layout; values outside are clipped.
            watch: Called after each tick, for rendering and for limits.

        Raises:
            InvalidActionError: If the action has another shape or is not finite.
            UsageError: If there was no ``reset()``.
        """
        return self.push(np.clip(self._checked(action), self._low, self._high), watch)

    def push(self, action: np.ndarray, watch: Watch | None = None) -> Step:
        """``step`` with whatever displacements: beyond what an action may ask."""
        if self._steps < 0:
            raise UsageError("step() was called before reset()")
        target_w = self._ee_w + self.config.action_scale * action[DELTA]
        self._alpha = float(action[ALPHA])
        if self.config.layout is HANDLING and self.drive.hand is not None:
            self.drive.hand.grip(bool(action[GRIP] > 0))
        plan = self._plan_base(target_w)
        motion = self._follow(target_w, plan, watch)
        self._steps += 1
        return self._outcome(target_w, plan, motion)

    def close(self) -> None:
        """Disconnect from the simulator."""
        self.drive.close()

    def _draw_load(self, rng: np.random.Generator) -> Scene:
        """A block between the fingers, or on a stand."""
        load = self.config.load
        assert load is not None
        mass, edge, friction = (
            float(rng.uniform(*interval))
            for interval in (load.mass, load.edge, load.friction)
        )
        block = Block((edge, edge, edge), mass, friction)
        if not load.on_stand:
            x, y, z = self._start_w.tolist()
            return Scene(block, (x, y, z), grasp=load.grasp)
        x, y, height = (
            float(rng.uniform(*interval))
            for interval in (load.stand_x, load.stand_y, load.stand_height)
        )
        stand = load.stand_edge, load.stand_edge, height
        return Scene(block, (x, y, height + edge / 2), stand, load.grasp)

    def _handle(self, scene: Scene) -> None:
        """Open the hand, or let it hold the block still for as long as a step."""
        load, drive = self.config.load, self.drive
        assert load is not None
        drive.hand = Hand(
            drive.world.handling,
            drive.model,
            scene,
            load.knowledge,
        )
        if load.on_stand:
            drive.hand.grip(False)
            if self._is_out_of_reach(scene):
                drive.hand.fail(OUT_OF_REACH)
            return
        drive.hand.take(self._ee_w)
        self._follow(self._start_w, BasePlan(0.0, 0.0, 0.0), None)

    def _is_out_of_reach(self, scene: Scene) -> bool:
        """Whether a block is too high, or too far for the base to get near in time."""
        x, y, z = scene.position_w
        travel = self.config.action_scale * self.config.max_steps  # of the hand
        return max(abs(x), abs(y)) > FAR + travel or z > HIGH

    def _checked(self, action: np.ndarray) -> np.ndarray:
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidActionError(
                f"action is {action!r}, expected numbers"
            ) from error
        if values.shape != self._low.shape:
            raise InvalidActionError(
                f"action has shape {values.shape}, expected {self._low.shape}: "
                f"{', '.join(self.config.layout.action)}"
            )
        if not np.isfinite(values).all():
            raise InvalidActionError(
                f"action is {values.tolist()}, expected finite numbers: check the "
                "policy's input for NaN"
            )
        return values

    def _plan_base(self, target_w: np.ndarray) -> BasePlan:
        """A plan from the measured base towards its place behind the hand's target."""
        config, base_w = self.config, self.drive.state.q[:2]
        way = target_w[0] - config.stand_off - base_w[0]
        advance = float(np.clip(way, -config.cruise, config.cruise))
        moves = abs(advance) > config.standing
        return BasePlan(
            float(base_w[0]), advance, float(np.sign(advance)) if moves else 0.0
        )

    def _follow(
        self, target_w: np.ndarray, plan: BasePlan, watch: Watch | None
    ) -> Motion:
        """Follow target and plan for a step's ticks."""
        config = self.config
        ticks = config.ticks_per_step
        speed = plan.advance * RATE / ticks
        points = plan.points(ticks)

        def reference_at(k: int, state: RobotState) -> Reference:
            y = state.q[1].item()
            heading = plan.heading(y, config.heading_gain, config.heading_limit)
            return Reference(
                target_w, self._ee_rotation_w, points[k], heading, speed, self._posture
            )

        priorities = self.drive.controller.priorities(self._alpha)
        motion = self.drive.follow(
            reference_at, priorities, ticks, config.look_every, watch
        )
        self._ee_w = self.drive.world.grasp_position_w()
        return motion

    def _joint_state(self) -> np.ndarray:
        state = self.drive.state
        base = [state.q[0], state.q[1], state.yaw]
        seen = [*self._ee_w, *base, self._alpha]
        if self.config.layout is HANDLING:
            handling = self.drive.world.handling
            seen += [handling.opening(), self._held(), *handling.block_w()[0]]
            seen += handling.stand_w
        return np.array([*seen, *self._goal_w])

    def _outcome(self, target_w: np.ndarray, plan: BasePlan, motion: Motion) -> Step:
        config = self.config
        after = self._joint_state()
        distance = goal_distance(after[config.layout.achieved], self._goal_w)
        d_mm = float(np.linalg.norm(target_w - self._ee_w))
        d_mp = float(np.linalg.norm(plan.points(1)[0] - self.drive.state.q[:2]))
        jerk = np.diff(motion.base_acceleration) * RATE
        jerk_rms = float(np.sqrt(np.mean(jerk * jerk))) if len(jerk) else 0.0
        failure = "" if self.drive.hand is None else self.drive.hand.failure
        held = self._held()
        success = bool(reached(distance, config, held)) and not failure
        reward = reach_reward(
            distance,
            np.asarray(d_mm),
            np.asarray(d_mp),
            np.asarray(jerk_rms),
            config,
            bool(failure),
            held,
        )
        info: dict[str, Any] = {
            "d_mm": d_mm,
            "d_mp": d_mp,
            "distance": float(distance),
            "is_success": success,
            "base_jerk_rms": jerk_rms,
            "base_acceleration_rms": float(
                np.sqrt(np.mean(motion.base_acceleration**2))
            ),
            "zmp_margin": motion.zmp_margin,
            "tilt": motion.tilt,
            "base_pitch": motion.base_pitch,
            "wheel_slip": motion.wheel_slip,
            "model_ee_error": motion.model_ee_error,
            "qp_failures": motion.qp_failures,
            "safe_ticks": motion.safe_ticks,
        }
        if self.drive.hand is not None:
            info["reason"], info["held"] = failure, held
        ended = success or bool(failure)
        truncated = self._steps >= config.max_steps and not ended
        return Step(after, float(reward), ended, truncated, info)

    def _held(self) -> bool:
        """Whether a block has been held, clear of its stand, for long enough."""
        hand, load = self.drive.hand, self.config.load
        if hand is None or load is None:
            return False
        return hand.held and (not load.on_stand or hand.clear_ticks >= load.hold_ticks)


def _checked_goal(goal_w: np.ndarray) -> np.ndarray:
    try:
        goal = np.array(goal_w, dtype=np.float64)
    except (TypeError, ValueError):
        goal = np.empty(0)
    if goal.shape != (3,) or not np.isfinite(goal).all():
        raise UsageError(f"goal is {goal_w!r}, expected three finite numbers [m]")
    return goal
