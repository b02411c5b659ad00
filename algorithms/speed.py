"""How torch computes while it learns: what small networks on a CPU gain from.

``torch.compile`` is not used: of TD3+BC's update (two layers of 256, batch 256, one
core of an AMD EPYC) it made 4 % more a second, after 48 s of compiling, in which all of
a tuned run's updates are nearly done without.
"""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import torch

from marl_mm.algorithms.config_checks import Precision

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


_TRIED = 256
"""Rows and columns of the matrices of the trial."""

_AS_EXACT = 8.0
"""Times the error with which a product counts as exact, too."""


@contextmanager
def matrix_products(precision: Precision) -> Iterator[None]:
    """Have torch multiply float32 matrices so, and as before afterwards."""
    with _torch_precision(resolved(precision)):
        yield


def resolved(precision: Precision) -> Precision:
    """What ``auto`` means here."""
    if precision != "auto":
        return precision
    return "medium" if _medium_is_exact() else "highest"


@contextmanager
def _torch_precision(precision: str) -> Iterator[None]:
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@cache
def _medium_is_exact() -> bool:
    """Whether products with medium precision err no more than a few times as much.

    Where torch only takes another library for them, they do not (error 4e-5 against
    2e-5 on an AMD EPYC with oneDNN); rounded to bfloat16 they err a thousandfold.
    """
    numbers = torch.Generator().manual_seed(0)
    left, right = torch.randn(2, 1, _TRIED, _TRIED, generator=numbers)
    zero = torch.zeros(1, 1, _TRIED)
    true = left.double() @ right.double()
    on_gpu = torch.cuda.is_initialized()  # type: ignore[no-untyped-call]
    devices = ["cpu", "cuda"] if on_gpu else ["cpu"]

    def error(precision: str, device: str) -> float:
        with _torch_precision(precision):  # as ensembles of networks are multiplied
            factors = (one.to(device) for one in (zero, left, right))
            product = torch.baddbmm(*factors)
        return float((product.cpu().double() - true).abs().max())

    return all(error("medium", d) <= _AS_EXACT * error("highest", d) for d in devices)
