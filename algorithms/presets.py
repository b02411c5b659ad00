"""Hyper-parameters by name: ours, and those of the paper."""

from dataclasses import replace
from typing import Any, Literal

from marl_mm.algorithms.ddpg import DdpgConfig
from marl_mm.algorithms.mabc import MabcConfig
from marl_mm.algorithms.maddpg import MaddpgConfig
from marl_mm.algorithms.matd3_bc import Matd3BcConfig
from marl_mm.algorithms.td3_bc import Td3BcConfig

Preset = Literal["tuned", "paper"]

_TABLE_2 = {
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

_TABLE_3: dict[str, Any] = {
    "updates": 100_000,  # Table 3; 180,000 in Table 4
    "batch_size": 256,  # Table 3
    "actor_learning_rate": 5e-4,  # Table 3
    "critic_learning_rate": 5e-4,  # Table 3
    "discount": 0.95,  # Table 3
    "target_rate": 0.005,  # Table 3
    "q_weight": 2.5,  # Fujimoto & Gu 2021
    "q_weight_end": None,
    "policy_delay": 2,  # Fujimoto 2018
    "target_noise": 0.1,  # Table 3: "Standard deviation", of what it does not say
    "target_noise_clip": 0.5,  # Fujimoto 2018
    "future": 0.0,
    "elsewhere": 0.0,
    "imitate": "all",
    "imitation_weights": (1.0, 1.0, 1.0, 1.0),
    "imitation_scaled": False,
    "clip_targets": False,
    "layer_norm": False,
}
"""Table 3, and the cited source's choice where it is silent; ours in hidden layers and
the floor of deviations."""

OfflineConfig = MabcConfig | Td3BcConfig | Matd3BcConfig

_OFFLINE: dict[str, type[OfflineConfig]] = {
    "mabc": MabcConfig,
    "td3-bc": Td3BcConfig,
    "matd3-bc": Matd3BcConfig,
}

OFFLINE = tuple(_OFFLINE)
"""Names of the offline algorithms."""


def preset(algorithm: str, name: Preset = "tuned") -> DdpgConfig:
    """The config of ``ddpg``, ``ddpg-her``, ``maddpg`` or ``maddpg-her``."""
    config = MaddpgConfig() if algorithm.startswith("maddpg") else DdpgConfig()
    if name == "paper":
        config = replace(config, **_TABLE_2)  # type: ignore[arg-type]
        if isinstance(config, MaddpgConfig):
            config = replace(config, others="replay")  # Lowe 2017
    return config if algorithm.endswith("-her") else replace(config, hindsight=0)


def offline_preset(algorithm: str, name: Preset = "tuned") -> OfflineConfig:
    """The config of ``mabc``, ``td3-bc`` or ``matd3-bc``."""
    config: OfflineConfig = _OFFLINE[algorithm]()
    if name == "tuned":
        return config
    if isinstance(config, MabcConfig):
        return replace(
            config,
            updates=_TABLE_3["updates"],
            batch_size=_TABLE_3["batch_size"],
            learning_rate=_TABLE_3["actor_learning_rate"],
            future=0.0,
        )
    config = replace(config, **_TABLE_3)
    if isinstance(config, Matd3BcConfig):
        config = replace(config, critics="own", others="data")  # Pan 2022
    return config
