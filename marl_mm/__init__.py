"""Multi-agent offline reinforcement learning on a simulated mobile manipulator."""

from marl_mm.envs.registry import TASKS

__version__ = "0.1.0"

TASKS.names()  # registers them with Gymnasium, too
