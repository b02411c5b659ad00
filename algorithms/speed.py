"""Settings of torch for small networks: threads, memory and precision.

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
"""Parameters of glibc's mallopt(3)."""

_KEPT = 32 << 20
"""Size of the largest block that glibc can keep [bytes]."""


@contextmanager
def small_networks() -> Iterator[None]:
    """Use one thread in a block, as a second only costs, and keep freed memory.

    By default glibc gives large blocks back to the system and asks for them again,
    page by page, many times an update: up to a fifth of its time.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of glibc only
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 4 * _KEPT)
        mallopt(_MMAP_THRESHOLD, _KEPT)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def finish(device: str) -> None:
    """Wait for what a device is still at, before the time is taken."""
    if device == "cuda":
        torch.cuda.synchronize()


_TRIED = 256
"""Number of rows and columns of the trial's matrices."""

_AS_EXACT = 8.0
"""Factor of errors: the fast product counts as exact if its error is at most this many
times that of the full-precision one."""


@contextmanager
def matrix_products(precision: Precision, device: str = "cpu") -> Iterator[None]:
    """Set torch's precision of float32 products on a device for a block."""
    with _torch_precision(resolved(precision, device)):
        yield


def resolved(precision: Precision, device: str = "cpu") -> Precision:
    """Precision that ``auto`` stands for on a device of this machine."""
    if precision != "auto":
        return precision
    return "medium" if _medium_is_exact(device) else "highest"


@contextmanager
def _torch_precision(precision: str) -> Iterator[None]:
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@cache
def _medium_is_exact(device: str) -> bool:
    """Whether products with medium precision err no more than a few times as much.

    Where torch only takes another library for them, they do not (error 4e-5 against
    2e-5 on an AMD EPYC with oneDNN); rounded to bfloat16 they err a thousandfold.
    """
    numbers = torch.Generator().manual_seed(0)
    left, right = torch.randn(2, 1, _TRIED, _TRIED, generator=numbers)
    zero = torch.zeros(1, 1, _TRIED)
    true = left.double() @ right.double()

    def error(precision: str) -> float:
        with _torch_precision(precision):  # as ensembles of networks are multiplied
            factors = (matrix.to(device) for matrix in (zero, left, right))
            product = torch.baddbmm(*factors)
        return float((product.cpu().double() - true).abs().max())

    return error("medium") <= _AS_EXACT * error("highest")
