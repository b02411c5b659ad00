"""Values that the tuning draws hyper-parameters from, by algorithm."""

from collections.abc import Mapping, Sequence
from typing import Any

_RATES = (2e-4, 5e-4, 1e-3)
_DISCOUNTS = (0.9, 0.95, 0.99)
_CLONING = {
    "learning_rate": (2e-4, 5e-4, 1e-3, 2e-3),
    "batch_size": (128, 256, 512),
    "hidden": ((128, 128), (256, 256)),
}
_FLOW = {**_CLONING, "flow_steps": (5, 10)}
_CRITIC = {"learning_rate": _RATES, "discount": _DISCOUNTS}
_TD3_BC = {
    "actor_learning_rate": _RATES,
    "discount": _DISCOUNTS,
    "q_weight": (0.1, 0.2, 0.5, 1.0, 2.5),
    "future": (0.0, 0.2),
    "elsewhere": (0.0, 0.4),
}
_IQL = {**_CRITIC, "expectile": (0.5, 0.7, 0.9), "temperature": (1.0, 3.0, 10.0)}
_REBRAC = {
    **_CRITIC,
    "actor_weight": (0.01, 0.03, 0.1, 0.3, 1.0),
    "critic_weight": (0.0, 0.01, 0.1),
}
_CQL = {
    **_CRITIC,
    "conservatism": (0.1, 0.5, 2.0, 5.0),
    "sample_noise": (0.1, 0.2, 0.4),
    "bound_penalty": (0.0, 0.03, 0.3),
}
_FLOW_Q = {**_CRITIC, "distillation": (1.0, 3.0, 10.0, 30.0, 100.0)}
_Q_CHUNKING = _FLOW_Q | {"chunk": (2, 3, 5)}
_BEST_OF_N = {**_CRITIC, "samples": (4, 16, 32), "expectile": (0.5, 0.7, 0.9)}

RANGES: Mapping[str, Mapping[str, Sequence[Any]]] = {
    "bc": _CLONING,
    "mabc": _CLONING,
    "flow-bc": _FLOW,
    "ma-flow-bc": _FLOW,
    "td3-bc": _TD3_BC,
    "matd3-bc": _TD3_BC,
    "iql": _IQL,
    "ma-iql": _IQL,
    "rebrac": _REBRAC,
    "ma-rebrac": _REBRAC,
    "cql": _CQL,
    "cfcql": _CQL | {"focus": (0.0, 1.0)},
    "omar": _CQL | {"mix": (0.5, 0.7, 0.9)},
    "maicq": {
        **_CRITIC,
        "temperature": (0.1, 0.3, 1.0, 3.0, 10.0),
        # Below 10 few samples of a batch count; the source's code has 10 to 1000.
        "critic_temperature": (1.0, 10.0, 100.0),
    },
    "fql": _FLOW_Q,
    "mac-flow": _FLOW_Q,
    "best-of-n-joint": _BEST_OF_N,
    "best-of-n": _BEST_OF_N,
    "q-chunking": _Q_CHUNKING,
    "ma-q-chunking": _Q_CHUNKING,
}
"""Values that hyper-parameters are drawn from, by algorithm."""
