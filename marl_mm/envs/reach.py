"""Where datasets of version 1 say that the goal environment is."""

from marl_mm.envs.goal_env import GoalEnv as ReachEnv

__all__ = ["ReachEnv"]
