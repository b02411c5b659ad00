"""Datasets of episodes: Minari files, views of them, and their cards."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from marl_mm.datasets.dataset import load_dataset

__all__ = ["load_dataset"]


def __getattr__(name: str) -> Any:
    """Datasets when they are asked for: Minari comes with them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from marl_mm.datasets.dataset import load_dataset

    return load_dataset
