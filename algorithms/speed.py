"""How torch computes while it learns: what small networks on a CPU gain from."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import torch

Precision = Literal["highest", "medium"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Of glibc's mallopt(3)."""

_KEPT = 32 << 20
"""The largest block that glibc can be told to keep [bytes]."""


def prepare_for_small_networks() -> None:
    """One thread, as a second only costs; and freed memory stays with the process.

    By default glibc gives large blocks back to the system and asks for them again,
    page by page, many times an update: up to a fifth of its time.
    """
    torch.set_num_threads(1)
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of glibc only
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 4 * _KEPT)
        mallopt(_MMAP_THRESHOLD, _KEPT)


@contextmanager
def matrix_products(precision: Precision) -> Iterator[None]:
    """Have torch multiply float32 matrices so, and as before afterwards."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)
