"""Learning algorithms: each turns a dataset or an environment into a policy."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from marl_mm.algorithms.policy import load_policy
    from marl_mm.algorithms.pretrained import load_pretrained

__all__ = ["load_policy", "load_pretrained"]


def __getattr__(name: str) -> Any:
    """Policies when they are asked for: torch comes with them and takes a second."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from marl_mm.algorithms import policy, pretrained

    return getattr(policy if name == "load_policy" else pretrained, name)
