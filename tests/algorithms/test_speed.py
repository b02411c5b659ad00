"""Precision is as it was when the work is done; auto is what a trial shows."""

import pytest
import torch

from marl_mm.algorithms import speed
from marl_mm.algorithms.config_checks import Precision
from marl_mm.algorithms.speed import (
    matrix_products,
    resolved,
    small_networks,
)


@pytest.mark.parametrize("precision", ["highest", "medium"])
def test_precision_is_restored_after_an_error_too(precision: Precision) -> None:
    before = torch.get_float32_matmul_precision()
    with pytest.raises(KeyboardInterrupt), matrix_products(precision):
        assert torch.get_float32_matmul_precision() == precision
        raise KeyboardInterrupt
    assert torch.get_float32_matmul_precision() == before


@pytest.mark.parametrize(("exact", "expected"), [(True, "medium"), (False, "highest")])
def test_auto_is_medium_only_where_that_is_as_exact(
    exact: bool, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed, "_medium_is_exact", lambda device: exact)
    assert resolved("auto") == expected
    assert resolved("highest") == "highest" and resolved("medium") == "medium"


def test_a_product_that_is_rounded_to_bfloat16_does_not_pass_for_exact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the processor has no units for it, they are put in its place."""

    def rounding(bias: torch.Tensor, one: torch.Tensor, other: torch.Tensor) -> object:
        if torch.get_float32_matmul_precision() == "medium":
            one, other = one.bfloat16().float(), other.bfloat16().float()
        return bias + one @ other

    monkeypatch.setattr(torch, "baddbmm", rounding)
    assert not speed._medium_is_exact.__wrapped__("cpu")


def test_small_networks_learn_on_one_thread() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with small_networks():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
