"""Hyper-parameters by name: ours, and those of the paper."""

from dataclasses import replace
from typing import Literal

from marl_mm.algorithms.ddpg import DdpgConfig
from marl_mm.algorithms.maddpg import MaddpgConfig

Preset = Literal["tuned", "paper"]

_PAPER = {
    "updates_per_episode": 25,  # one per step of a whole episode (Algorithm 1)
    "episodes_per_cycle": 1,
    "warm_up": 5_000,  # Table 2
    "capacity": 5_000,  # Table 2
    "noise": 0.1,  # Table 2
    "random_share": 0.0,
    "action_penalty": 0.0,
    "clip_targets": False,
    "layer_norm": False,
}
"""Table 2, and the plain choice where it is silent."""


def preset(algorithm: str, name: Preset = "tuned") -> DdpgConfig:
    """The config of ``ddpg``, ``ddpg-her``, ``maddpg`` or ``maddpg-her``."""
    config = MaddpgConfig() if algorithm.startswith("maddpg") else DdpgConfig()
    if name == "paper":
        config = replace(config, **_PAPER)  # type: ignore[arg-type]
        if isinstance(config, MaddpgConfig):
            config = replace(config, others="replay")  # Lowe 2017
    return config if algorithm.endswith("-her") else replace(config, hindsight=0)
