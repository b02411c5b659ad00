"""Evaluation: fixed goals, rows per episode, success with its interval; ablations."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from marl_mm.eval.ablation import BEST, LAST, Ablation, Probe, Setting

__all__ = ["BEST", "LAST", "Ablation", "Probe", "Setting"]


def __getattr__(name: str) -> Any:
    """Ablations when they are asked for: torch comes with them and takes a second."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from marl_mm.eval import ablation

    return getattr(ablation, name)
