"""Maps over processes: order, completion, and processes that crash or hang."""

import os
import time

import pytest

from marl_mm.errors import UsageError, WorkerDiedError
from marl_mm.workers import Workers, apart


def doubled(value: int) -> int:
    if value < 0:
        raise UsageError(f"{value} is negative")
    return 2 * value


def late_if_even(value: int) -> int:
    time.sleep(0.5 * (value % 2 == 0))
    return value


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
    with Workers(2) as pool:
        assert list(pool.map(late_if_even, range(6))) == list(range(6))
        ready = list(pool.completed(late_if_even, range(6)))
        assert sorted(ready) == list(range(6))
        assert ready != list(range(6))
        with pytest.raises(UsageError, match="-1 is negative"):
            list(pool.completed(doubled, [1, -1]))
        with pytest.raises(WorkerDiedError, match="fewer --workers"):
            list(pool.completed(crash, [1]))
