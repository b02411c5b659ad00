"""A function over many items, in this process or in several, in the items' order."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.interrupts import deaf_to_interrupts

T = TypeVar("T")
R = TypeVar("R")


def ordered_map(
    function: Callable[[T], R],
    items: Iterable[T],
    workers: int,
    initializer: Callable[..., None] | None = None,
    arguments: tuple[Any, ...] = (),
    ahead: int = 4,
) -> Iterator[R]:
    """Results in the order of ``items``, which may be endless.

    Args:
        function: Importable by name, as it runs in spawned processes.
        items: What to apply it to.
        workers: Processes; 1 runs in this one.
        initializer: Called once in every process.
        arguments: Of the initializer.
        ahead: Items handed out per worker beyond the one awaited; an interrupt waits
            for those that have begun.

    Raises:
        UsageError: If ``workers`` is not positive.
        MarlMmError: If a worker process dies.
    """
    if workers < 1:
        raise UsageError(f"workers is {workers}, expected >= 1")
    if workers == 1:
        if initializer is not None:
            initializer(*arguments)
        yield from map(function, items)
        return
    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer, arguments)
    remaining = iter(items)
    pending: deque[Future[R]] = deque()
    try:
        with deaf_to_interrupts():  # the workers start here, and inherit it
            for item in islice(remaining, workers * ahead):
                pending.append(pool.submit(function, item))
        while pending:
            result = pending.popleft().result()
            for item in islice(remaining, 1):
                pending.append(pool.submit(function, item))
            yield result
    except BrokenProcessPool as error:
        raise MarlMmError(
            "a worker process died; if memory ran out, use fewer --workers"
        ) from error
    finally:
        # At most a few items are in flight; an interrupted wait would hang at exit.
        with deaf_to_interrupts():
            pool.shutdown(wait=True, cancel_futures=True)
