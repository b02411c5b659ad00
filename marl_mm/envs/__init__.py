"""The reach tasks, for one agent (Gymnasium) or two (PettingZoo)."""

from marl_mm.envs.parallel import ReachParallelEnv as parallel_env

__all__ = ["parallel_env"]
