"""Drive a robot by an exported policy: ``python robot_loop.py POLICY.ts``.

MuJoCo's robot stands in for yours. Replace the four lines that are marked.
"""

import sys

import numpy as np
import torch

from marl_mm.control.config import ControllerConfig
from marl_mm.control.records import Track
from marl_mm.control.wbc import WholeBodyController
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.limits import robot_limits
from marl_mm.robot.model import RobotModel
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.world import open_world

REACHED = 0.05
"""Distance at which the goal counts as reached [m]."""


def reach(policy: torch.jit.ScriptModule, goal: np.ndarray, seconds: int = 25) -> float:
    """Reach a goal of Reach-v0, shape (3,) [m]; return the hand's distance to it [m].

    Positions are in the frame of the start: x ahead, y to the left, z up.
    """
    robot = RobotConfig()
    model = RobotModel(robot)
    controller = WholeBodyController(robot_limits(robot), ControllerConfig())
    world = open_world(robot, SimulationConfig(engine="mujoco"))  # yours: connect
    world.reset()
    state = world.read()  # yours: measure q and v; RobotModel has their entries
    start = model.evaluate(state)
    rotation, alpha = start.rotation_w.copy(), 1.0
    ahead = start.position_w[0] - state.q[0]  # of the hand before the base
    for _ in range(seconds):
        # Once a second: the policy sets the hand's next target, and alpha.
        x, y = state.q[:2]
        hand = model.evaluate(state).position_w.copy()
        seen = np.array([[*hand, x, y, state.yaw, alpha, *goal]], np.float32)
        *displacement, alpha = policy(torch.as_tensor(seen))[0].tolist()
        target = hand + 0.1 * np.array(displacement)
        # The base drives slowly along x towards its place behind the target.
        way = float(np.clip(target[0] - ahead - x, -0.03, 0.03))
        plan = np.stack([x + way * np.arange(1, 241) / 240, np.zeros(240)], axis=1)
        track = Track(
            target,
            rotation,
            plan,
            heading_gain=1.0,
            heading_limit=0.3,
            direction=float(np.sign(way)) if abs(way) > 0.005 else 0.0,
            speed=way,
            posture=np.array(robot.initial_joints),
        )
        # 240 times a second: the controller turns them into speeds and torques.
        for k in range(240):
            terms = model.evaluate(state)
            command = controller.tick(state, terms, track(k, state), alpha)
            world.command(*command.base_speed, command.torque)  # yours: send
            world.step()
            state = world.read()  # yours: measure
        distance = np.linalg.norm(goal - model.evaluate(state).position_w, axis=-1)
        if distance < REACHED:
            break
    world.close()
    return float(distance)


if __name__ == "__main__":
    goal = np.array([1.2, 0.1, 0.7])
    left = reach(torch.jit.load(sys.argv[1]), goal)
    print(f"{1000 * left:.0f} mm from the goal")
