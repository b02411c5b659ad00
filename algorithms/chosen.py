"""Hyper-parameters that the tuning chose, by algorithm, as its table says."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from marl_mm.algorithms.registry import BENCHMARK, TUNED

Config = TypeVar("Config", bound=Any)

UPDATES = 20_000
"""Updates of the benchmark; see its page for what fewer do."""

CHOSEN: Mapping[str, Mapping[str, Any]] = {
    "bc": {"learning_rate": 0.0005, "batch_size": 128, "hidden": (128, 128)},
    "best-of-n-joint": {
        "learning_rate": 0.001,
        "discount": 0.95,
        "samples": 16,
        "expectile": 0.9,
    },
    "best-of-n": {
        "learning_rate": 0.0002,
        "discount": 0.95,
        "samples": 4,
        "expectile": 0.9,
    },
    "cfcql": {
        "learning_rate": 0.001,
        "discount": 0.9,
        "conservatism": 2.0,
        "sample_noise": 0.1,
        "bound_penalty": 0.03,
        "focus": 1.0,
    },
    "cql": {
        "learning_rate": 0.0005,
        "discount": 0.95,
        "conservatism": 2.0,
        "sample_noise": 0.2,
        "bound_penalty": 0.3,
    },
    "flow-bc": {
        "learning_rate": 0.001,
        "batch_size": 512,
        "hidden": (256, 256),
        "flow_steps": 5,
    },
    "fql": {"learning_rate": 0.001, "discount": 0.9, "distillation": 10.0},
    "iql": {
        "learning_rate": 0.0002,
        "discount": 0.95,
        "expectile": 0.5,
        "temperature": 10.0,
    },
    "ma-flow-bc": {
        "learning_rate": 0.001,
        "batch_size": 512,
        "hidden": (256, 256),
        "flow_steps": 5,
    },
    "ma-iql": {
        "learning_rate": 0.0002,
        "discount": 0.95,
        "expectile": 0.7,
        "temperature": 3.0,
    },
    "ma-rebrac": {
        "learning_rate": 0.001,
        "discount": 0.95,
        "actor_weight": 1.0,
        "critic_weight": 0.1,
    },
    "mabc": {"learning_rate": 0.002, "batch_size": 256, "hidden": (128, 128)},
    "mac-flow": {"learning_rate": 0.0005, "discount": 0.95, "distillation": 3.0},
    "maicq": {
        "learning_rate": 0.0002,
        "discount": 0.99,
        "temperature": 1.0,
        "critic_temperature": 10.0,
    },
    "matd3-bc": {
        "actor_learning_rate": 0.001,
        "discount": 0.95,
        "q_weight": 0.1,
        "future": 0.2,
        "elsewhere": 0.0,
    },
    "omar": {
        "learning_rate": 0.0002,
        "discount": 0.9,
        "conservatism": 5.0,
        "sample_noise": 0.4,
        "bound_penalty": 0.0,
        "mix": 0.7,
    },
    "ma-q-chunking": {
        "learning_rate": 0.001,
        "discount": 0.9,
        "distillation": 1.0,
        "chunk": 3,
    },
    "q-chunking": {},
    "rebrac": {
        "learning_rate": 0.0005,
        "discount": 0.9,
        "actor_weight": 0.3,
        "critic_weight": 0.0,
    },
    "td3-bc": {
        "actor_learning_rate": 0.0002,
        "discount": 0.9,
        "q_weight": 0.1,
        "future": 0.0,
        "elsewhere": 0.0,
    },
}
"""Values that replace the presets', by registered name; none where none is tuned."""


def presets_of(name: str, tuned: Config) -> dict[str, Config]:
    """The default preset of an algorithm, and the benchmark's.

    Args:
        name: Registered name of the algorithm.
        tuned: Its default hyper-parameters.
    """
    return {TUNED: tuned, BENCHMARK: replace(tuned, **CHOSEN[name], updates=UPDATES)}
