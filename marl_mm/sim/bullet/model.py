"""The robot's URDF, as PyBullet reads it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from marl_mm.robot.description import RobotConfig, urdf_xml
from marl_mm.sim.bullet.engine import pybullet_data
from marl_mm.temporary import named_errors


@cache
def _urdf(robot: RobotConfig, solid: bool) -> str:
    """URDF with absolute names of the meshes, which lie in pybullet_data."""
    meshes = f"{pybullet_data.getDataPath()}/franka_panda"
    return urdf_xml(robot, solid).replace('"franka_panda', f'"{meshes}')


@contextmanager
def urdf_file(robot: RobotConfig, solid: bool) -> Iterator[str]:
    """Name of a file in memory with the URDF.

    For each client, PyBullet keeps for good what it has read from a name, and does not
    read it again. So there are few names, and they differ where the contents do.
    """
    with os.fdopen(os.memfd_create("robot.urdf"), "w") as file:
        with named_errors(Path("robot.urdf, in memory")):
            file.write(_urdf(robot, solid))
            file.flush()
        process = os.getpid() if solid else "self"
        yield f"/proc/{process}/fd/{file.fileno()}"
