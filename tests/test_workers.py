"""Maps over processes: order, completion, and processes that crash or hang."""

import os
import time
from functools import partial

import pytest

from marl_mm.errors import UsageError, WorkerDiedError
from marl_mm.workers import Workers, apart


def doubled(value: int) -> int:
    if value < 0:
        raise UsageError(f"{value} is negative")
    return 2 * value


def crash(value: int) -> int:
    os._exit(value)


def hang(value: int) -> int:
    time.sleep(600)
    return value


def test_apart_gives_results_and_errors() -> None:
    assert apart(doubled, 4, seconds=60) == 8
    with pytest.raises(UsageError, match="-1 is negative"):
        apart(doubled, -1, seconds=60)


def test_apart_survives_a_crash_and_ends_what_hangs() -> None:
    with pytest.raises(WorkerDiedError, match="crashed"):
        apart(crash, 3, seconds=60)
    with pytest.raises(WorkerDiedError, match="no end after 1 s"):
        apart(hang, 3, seconds=1)


@pytest.mark.slow
def test_results_come_in_order_or_as_they_are_ready() -> None:
    function = partial(pow, 2)  # which other processes can import
    with Workers(2) as pool:
        assert list(pool.map(function, range(9))) == [2**i for i in range(9)]
        assert sorted(pool.completed(function, range(9))) == [2**i for i in range(9)]
        with pytest.raises(ZeroDivisionError):
            list(pool.completed(partial(divmod, 1), [1, 0]))
        with pytest.raises(WorkerDiedError, match="fewer --workers"):
            list(pool.completed(os._exit, [1]))
