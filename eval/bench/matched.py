"""Our single-agent algorithms with the networks and settings of d3rlpy's."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.eval.bench import d3rlpy_reference as theirs

SIZES: dict[str, Any] = {"batch_size": theirs.BATCH, "hidden": theirs.HIDDEN}
"""Settings of all learners whose updates are timed."""

_SHARED: dict[str, Any] = {
    **SIZES,
    "discount": theirs.DISCOUNT,
    "learning_rate": theirs.RATE,
    "actor_learning_rate": theirs.RATE,
    "critic_learning_rate": theirs.RATE,
    "future": 0.0,
    "elsewhere": 0.0,
    "clip_targets": False,
    "layer_norm": False,
}

_CQL = {
    "policy_delay": 1,
    "bound_penalty": 1.0,  # d3rlpy's first temperature of SAC's entropy
    "conservatism": theirs.CONSERVATISM,
    "samples": theirs.SAMPLES,
    "penalized": theirs.BATCH,
}

_OWN: dict[str, dict[str, Any]] = {
    "td3-bc": {
        "q_weight": theirs.Q_WEIGHT,
        "imitate": "all",
        "imitation_scaled": False,
    },
    "iql": {"expectile": theirs.EXPECTILE, "temperature": theirs.TEMPERATURE},
    "rebrac": {
        "actor_weight": theirs.ACTOR_PENALTY,
        "critic_weight": theirs.CRITIC_PENALTY,
    },
    "cql": _CQL,
    "cal-ql": _CQL,
}


def with_settings(name: str, settings: dict[str, Any], base: str = TUNED) -> Any:
    """Preset of an algorithm with those of the settings that it has."""
    default = preset(name, base)
    known = {field.name for field in fields(default)}
    return replace(default, **{k: v for k, v in settings.items() if k in known})


def matched(name: str, **settings: Any) -> Any:
    """Hyper-parameters of ours that match d3rlpy's.

    What stays different: d3rlpy's actors of IQL and CQL are Gaussian and that of CQL is
    SAC's, which adapts the weight of its entropy; ours give one action, and CQL's is
    TD3's, with that weight's first value as ``bound_penalty``.
    """
    return with_settings(name, _SHARED | _OWN.get(name, {}) | settings)


def learner(name: str, config: Any, arrays: Any, judge: Any, seed: int = 0) -> Any:
    """A learner of one seed on a CPU."""
    make: Callable[..., Any] = ALGORITHMS.get(name).learner
    return make(config, arrays, judge, [seed], "cpu")
