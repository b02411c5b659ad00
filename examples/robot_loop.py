"""Drive a robot by an exported policy of Reach-v0.

``python robot_loop.py POLICY.ts [X Y Z]`` takes the hand to a goal [m], in the frame of
the start: x ahead, y to the left, z up. MuJoCo's robot stands in for yours: write the
class ``Robot`` anew, and name in ``TASK`` what the policy was trained with.
"""

import json
import sys

import numpy as np
import torch

from marl_mm.control.records import Command, Track
from marl_mm.control.wbc import WholeBodyController
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import Reach
from marl_mm.robot.limits import robot_limits
from marl_mm.robot.model import RobotModel, RobotState
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.world import open_world

TASK = make_task("Reach-v0", {"robot": {"base_mass": 82.0}})
"""The task, whose numbers robot, controller and base follow."""

TICKS = 240
"""Ticks of the controller in a second."""


class Robot:
    """A robot that is commanded 240 times a second."""

    def __init__(self) -> None:
        self._world = open_world(TASK.robot, SimulationConfig(engine="mujoco"))

    def start(self) -> None:
        """Go to the start posture, ``TASK.robot.initial_joints``; this is x = y = 0."""
        self._world.reset()

    def read(self) -> RobotState:
        """Measure q: x, y [m], cos and sin of the heading, seven joints [rad].

        And v: forward and lateral speed of the base [m/s], its turning rate, seven
        joint rates [rad/s].
        """
        return self._world.read()

    def send(self, command: Command) -> None:
        """Command the base's speed [m/s] and turning rate [rad/s], and joint torques.

        Torques [N m] are whole: leave gravity out for an arm that adds it by itself.
        """
        self._world.command(*command.base_speed, command.torque)

    def wait(self) -> None:
        """Wait for the next tick."""
        self._world.step()

    def stop(self) -> None:
        """Stop base and arm, whatever has happened."""
        self._world.close()


def reach(policy: torch.jit.ScriptModule, goal: np.ndarray, robot: Robot) -> float:
    """Reach a goal, shape (3,) [m]; return the hand's distance to it [m]."""
    assert isinstance(TASK, Reach)
    model = RobotModel(TASK.robot)
    controller = WholeBodyController(robot_limits(TASK.robot), TASK.controller, TICKS)
    posture = np.array(TASK.robot.initial_joints)

    def act(state: RobotState, alpha: float) -> np.ndarray:
        """Displacement of the hand's target [0.1 m], and alpha, shape (4,)."""
        hand, (x, y) = model.evaluate(state).position_w, state.q[:2]
        seen = np.array([[*hand, x, y, state.yaw, alpha, *goal]], np.float32)
        with torch.no_grad():
            action: np.ndarray = policy(torch.as_tensor(seen))[0].double().numpy()
        if not (np.isfinite(seen).all() and np.isfinite(action).all()):
            raise ValueError(f"state {seen.tolist()} or action {action} is not finite")
        return action

    def follow(state: RobotState, target: np.ndarray, axes: np.ndarray) -> Track:
        """The hand's target, and a slow drive of the base to its place behind it."""
        way = target[0] - TASK.stand_off - state.q[0]
        way = float(np.clip(way, -TASK.cruise, TASK.cruise))
        line = state.q[0] + way * np.arange(1, TICKS + 1) / TICKS
        return Track(
            target,
            axes,
            points=np.stack([line, np.zeros(TICKS)], axis=1),
            heading_gain=TASK.heading_gain,
            heading_limit=TASK.heading_limit,
            direction=float(np.sign(way)) if abs(way) > TASK.standing else 0.0,
            speed=way,
            posture=posture,
        )

    # The first calls compile, which takes up to half a minute.
    rest, alpha = RobotState(np.array([0, 0, 1, 0, *posture]), np.zeros(10)), 0.5
    terms = model.evaluate(rest)
    axes = terms.rotation_w.copy()
    track = follow(rest, terms.position_w.copy(), axes)
    for _ in range(3):
        controller.tick(rest, model.evaluate(rest), track(0, rest), alpha)
        act(rest, alpha)

    alpha = TASK.initial_alpha
    try:
        robot.start()
        state = robot.read()
        for _ in range(TASK.max_steps):
            # Once a second: the policy.
            *displacement, alpha = act(state, alpha).tolist()
            hand = model.evaluate(state).position_w.copy()
            target = hand + TASK.action_scale * np.array(displacement)
            track = follow(state, target, axes)
            # 240 times a second: the controller.
            for k in range(TICKS):
                terms = model.evaluate(state)
                robot.send(controller.tick(state, terms, track(k, state), alpha))
                robot.wait()
                state = robot.read()
            hand = model.evaluate(state).position_w.copy()
            distance = float(np.linalg.norm(goal - hand, axis=-1))
            if distance < TASK.success_distance:
                break
    finally:
        robot.stop()
    return distance


def load(path: str) -> torch.jit.ScriptModule:
    """An exported policy that sees Reach's joint state and sets one action."""
    extra = {"marl_mm": ""}
    policy = torch.jit.load(path, _extra_files=extra)  # type: ignore[no-untyped-call]
    metadata = json.loads(extra["marl_mm"])
    wanted = [*TASK.layout.state_names]
    if metadata["observation"] != wanted or "noise" in metadata:
        sys.exit(f"{path} is no policy of the joint state alone: {metadata}")
    return policy


if __name__ == "__main__":
    if len(sys.argv) not in (2, 5):
        sys.exit("expected POLICY.ts, or POLICY.ts X Y Z")
    goal = np.array([float(text) for text in sys.argv[2:]] or [1.2, 0.1, 0.7])
    left = reach(load(sys.argv[1]), goal, Robot())
    print(f"{1000 * left:.0f} mm from the goal")
