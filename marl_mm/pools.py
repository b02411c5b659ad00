"""Pools of worker processes that are forked from the server, and end with this one."""

import os
import pickle
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from multiprocessing import connection, parent_process
from typing import Any, TypeVar

from marl_mm.errors import MarlMmError, UsageError, WorkerDiedError
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.plugins import Carried
from marl_mm.processes import check_importable, process_context, starting

T = TypeVar("T")
R = TypeVar("R")


def gathered(futures: Sequence[Future[R]]) -> list[R]:
    """Results of calls; an error or an interrupt is raised after the last has ended."""
    try:
        return [future.result() for future in futures]
    except BaseException:
        for future in futures:
            future.cancel()
        with deaf_to_interrupts():
            wait(futures)
        raise


def opened(
    workers: int,
    initializer: Callable[..., None] | None,
    arguments: tuple[Any, ...],
    threads: bool = False,
) -> Executor:
    """Processes that start with the first call, with this process's plug-ins.

    Args:
        workers: Number of processes.
        initializer: Function that is called once in every process.
        arguments: Arguments of the initializer.
        threads: Have threads of this process instead.
    """
    if threads:
        return ThreadPoolExecutor(workers, "", initializer, arguments)
    check_importable(arguments)
    first = Carried(), dict(os.environ), initializer, arguments
    context = process_context((initializer or _begin).__module__)
    return ProcessPoolExecutor(workers, context, _begin, first)


def submit(
    pools: Iterable[Executor],
    function: Callable[[T], R],
    items: Iterable[T],
) -> list[Future[R]]:
    """Hand out items, one to each pool in turn."""
    # Pickled here: the pool's own thread meets an item that cannot be pickled, and
    # a pool that is closed meanwhile waits for that item forever.
    pairs = [
        (pool, _packed((function, each)))
        for each, pool in zip(items, pools, strict=False)
    ]
    apart = (each for pool, each in pairs if isinstance(pool, ProcessPoolExecutor))
    check_importable(apart)
    # Workers start here, and inherit the signal mask.
    with deaf_to_interrupts(), dead_servers_named(), starting():
        return [pool.submit(_call, each) for pool, each in pairs]


def _packed(call: tuple[Callable[[T], R], T]) -> bytes:
    try:
        return pickle.dumps(call)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise UsageError(
            f"workers cannot have {call[1]!r:.60} ({error}): use `workers=1`"
        ) from error


def close(pools: Iterable[Executor]) -> None:
    """End the processes when they have finished their present calls."""
    # At most a few items are in flight; an interrupted wait would hang at exit.
    with deaf_to_interrupts():
        for pool in pools:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def dead_servers_named() -> Iterator[None]:
    """Explain the failure if the fork server is dead when a process is asked for."""
    try:
        yield
    except (EOFError, ConnectionError) as error:
        raise WorkerDiedError(
            "the process that starts the workers died; is there enough memory?"
        ) from error


@contextmanager
def broken_pools_named(pending: Collection[Future[Any]]) -> Iterator[None]:
    """Explain the failure of a pool, and cancel waiting items when the block ends."""
    try:
        yield
    except BrokenExecutor as error:
        raise WorkerDiedError(
            "a worker process died; if memory ran out, use fewer `workers`"
        ) from error
    finally:
        for future in pending:
            future.cancel()


def _begin(
    plugins: Any,
    environment: dict[str, str],
    initializer: Callable[..., None] | None,
    arguments: tuple[Any, ...],
) -> None:
    """Set up a worker: it ends with its parent, even if the parent is killed.

    Its environment variables are the parent's of now, not the fork server's.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    live_in(environment)
    if initializer is not None:
        initializer(*arguments)


def _call(packed: bytes) -> Any:
    function, item = pickle.loads(packed)
    try:
        return function(item)
    except Exception as error:
        if (sent := transferable(error)) is not error:
            raise sent from None
        raise


def transferable(error: Exception) -> Exception:
    """An error, or one of its text where pickling would lose or break it."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return MarlMmError(f"{type(error).__name__}: {error}")
    return error


def live_in(environment: dict[str, str]) -> None:
    """Replace this process's environment variables."""
    os.environ.clear()
    os.environ.update(environment)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
