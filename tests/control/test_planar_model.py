"""The compiled planar model agrees with Pinocchio, with a load in the hand too."""

import numpy as np
import pytest

from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState
from marl_mm.robot.planar import PlanarModel

STATES = 10_000

ROBOTS = RobotConfig(), RobotConfig(base_mass=60.0, base_com_b=(0.03, -0.02, 0.25))


@pytest.mark.parametrize("robot", ROBOTS, ids=["usual", "other"])
def test_terms_and_zero_moment_point_are_those_of_pinocchio(robot: RobotConfig) -> None:
    rng = np.random.default_rng(0)
    oracle, model = RobotModel(robot, balance=True), PlanarModel(robot)
    for number in range(STATES // len(ROBOTS)):
        if number % 50 == 0:
            mass = rng.uniform(0, 5) * (number % 100 > 0)
            size = tuple(rng.uniform(0.02, 0.08, 3).tolist())
            oracle.carry(mass, size)
            model.carry(mass, size)
        yaw = rng.uniform(-np.pi, np.pi)
        pose = [*rng.uniform(-3, 3, 2), np.cos(yaw), np.sin(yaw)]
        state = RobotState(
            np.array([*pose, *rng.uniform(-2.9, 2.9, 7)]), rng.uniform(-3, 3, 10)
        )
        expected, terms = oracle.evaluate(state), model.evaluate(state)
        for name in ModelTerms._fields:
            values = getattr(expected, name)
            room = 1e-10 * max(1.0, np.abs(values).max())
            assert np.abs(getattr(terms, name) - values).max() <= room, name
        u = rng.uniform(-2, 2, 9)
        point = oracle.zmp_b(state, u)
        assert np.abs(model.zmp_b(state, u) - point).max() <= 1e-10
