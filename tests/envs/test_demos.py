"""The paper's Fig. 3: one half of the robot moves, the other drifts but little."""

from collections.abc import Iterator

import numpy as np
import pytest

from marl_mm.envs.demos import arm_reach, base_turn, demo_drive
from marl_mm.envs.drive import Drive


@pytest.fixture
def drive() -> Iterator[Drive]:
    drive = demo_drive()
    yield drive
    drive.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    "target", [(0.8, 0.3, 0.8), (0.7, -0.3, 0.5), (0.55, 0.1, 0.9)]
)
def test_the_arm_reaches_a_point_while_the_base_stands(
    drive: Drive, target: tuple[float, float, float]
) -> None:
    drift = arm_reach(drive, np.array(target), 4.0)
    assert drift.position_error is not None and drift.position_error < 1e-3
    assert drift.base_drift < 2e-3
    assert drift.heading_drift is not None
    assert drift.heading_drift < np.deg2rad(0.25)


@pytest.mark.parametrize("angle", [90.0, -45.0, 170.0])
def test_the_base_turns_to_an_angle_while_the_arm_rests(
    drive: Drive, angle: float
) -> None:
    drift = base_turn(drive, np.deg2rad(angle), 4.0)
    assert drift.heading_error is not None and drift.arm_drift is not None
    assert drift.heading_error < np.deg2rad(0.1)
    assert drift.base_drift < 2e-3
    assert drift.arm_drift < np.deg2rad(0.5)
