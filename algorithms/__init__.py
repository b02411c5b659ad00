"""Algorithms: from a dataset or an environment to a policy that needs only itself."""

from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import load_pretrained

__all__ = ["load_policy", "load_pretrained"]
