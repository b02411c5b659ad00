"""The place of the goal environment that datasets of version 1 name."""

from marl_mm.envs.goal_env import GoalEnv as ReachEnv

__all__ = ["ReachEnv"]
