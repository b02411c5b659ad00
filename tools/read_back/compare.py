"""Comparison of what a library read with the reference; needs numpy alone."""

import sys
from collections.abc import Mapping
from importlib.metadata import version

import numpy as np


def ends(lengths: np.ndarray) -> np.ndarray:
    """Whether a step is its episode's last, shape (n,), bool."""
    last = np.zeros(lengths.sum(), bool)
    last[np.cumsum(lengths) - 1] = True
    return last


def report(
    library: str, read: Mapping[str, object], expected: Mapping[str, np.ndarray]
) -> None:
    """Print how many values differ by key and in all; exit with 1 if any do.

    Expected values are rounded to the type that was read.
    """
    total = wrong = 0
    for key, wanted in expected.items():
        values = np.asarray(read[key])
        same = values.shape == wanted.shape
        differ = (
            int((values != wanted.astype(values.dtype)).sum()) if same else wanted.size
        )
        print(f"{key}: {values.shape} {values.dtype}, {differ} differ")
        total, wrong = total + wanted.size, wrong + differ
    print(f"{library} {version(library)}: {total:,} values, {wrong} differ")
    sys.exit(wrong > 0)
