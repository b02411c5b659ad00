"""MuJoCo; the other modules here take it from this one."""

import mujoco

__all__ = ["mujoco"]
