"""Maps over processes: order, completion, and processes that crash or hang.

Functions are those that any process can import by name.
"""

import os
import time
from functools import partial

import pytest

from marl_mm.errors import WorkerDiedError
from marl_mm.workers import Workers, apart


def test_apart_gives_results_and_errors() -> None:
    assert apart(abs, -4, seconds=60) == 4
    with pytest.raises(ValueError, match="invalid literal"):
        apart(int, "four", seconds=60)


def test_apart_survives_a_crash_and_ends_what_hangs() -> None:
    with pytest.raises(WorkerDiedError, match="crashed"):
        apart(os._exit, 3, seconds=60)
    with pytest.raises(WorkerDiedError, match="no end after 1 s"):
        apart(time.sleep, 600, seconds=1)


@pytest.mark.slow
def test_results_come_in_order_or_as_they_are_ready() -> None:
    function = partial(pow, 2)
    with Workers(2) as pool:
        assert list(pool.map(function, range(9))) == [2**i for i in range(9)]
        assert sorted(pool.completed(function, range(9))) == [2**i for i in range(9)]
        with pytest.raises(ZeroDivisionError):
            list(pool.completed(partial(divmod, 1), [1, 0]))
        with pytest.raises(WorkerDiedError, match="fewer --workers"):
            list(pool.completed(os._exit, [1]))
