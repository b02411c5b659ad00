"""Multi-agent offline reinforcement learning on a simulated mobile manipulator."""

from marl_mm.envs.registry import TASKS
from marl_mm.plugins import load_installed

__version__ = "0.1.0"

TASKS.names()  # registers them with Gymnasium, too
load_installed()
