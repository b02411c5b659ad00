"""Offline algorithms: from a dataset to a policy that needs nothing but itself."""

from marl_mm.algorithms.policy import load_policy

__all__ = ["load_policy"]
