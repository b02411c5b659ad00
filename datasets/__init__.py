"""Datasets of episodes: Minari files, views of them, and their cards."""

from marl_mm.datasets.dataset import load_dataset

__all__ = ["load_dataset"]
