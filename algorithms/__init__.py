"""Algorithms: from a dataset or an environment to a policy that needs only itself."""

from marl_mm.algorithms.policy import load_policy

__all__ = ["load_policy"]
