"""A function over many items, in this process or in several."""

import os
import pickle
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from multiprocessing import connection, parent_process
from typing import Any, Literal, Protocol, TypeVar, cast

from marl_mm.errors import UsageError, WorkerDiedError
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.plugins import Carried
from marl_mm.processes import limit_memory, process_context

T = TypeVar("T")
R = TypeVar("R")

Executor = Literal["local", "ray"]


def available_cores() -> int:
    """Number of cores that this process may use; ``PYTHON_CPU_COUNT`` overrides it.

    Python 3.13 has it as ``os.process_cpu_count``.

    Raises:
        UsageError: If the variable is no number.
    """
    text = os.environ.get("PYTHON_CPU_COUNT", "default")
    if text == "default":
        return len(os.sched_getaffinity(0))
    if not text.isdecimal() or int(text) < 1:
        raise UsageError(f"PYTHON_CPU_COUNT is {text!r}, expected a number of cores")
    return int(text)


class Pool(Protocol):
    """Worker processes, of this machine or of a cluster."""

    def close(self) -> None:
        """End the processes."""

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results in the order of ``items``, which may be endless."""

    def completed(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results in the order in which they are ready."""


def open_pool(
    executor: Executor,
    workers: int,
    initializer: Callable[..., None],
    arguments: tuple[Any, ...],
) -> Pool:
    """Processes of this machine, or of a Ray cluster.

    Raises:
        UsageError: If ``workers`` is not positive, or Ray is not installed.
    """
    if executor == "local":
        return Workers(workers, initializer, arguments)
    if find_spec("ray") is None:
        raise UsageError("ray is missing: pip install 'marl-mm[ray]'")
    from marl_mm.ray_workers import RayWorkers

    return RayWorkers(workers, initializer, arguments)


class Workers:
    """Processes that are kept for many maps; use it in a ``with`` block.

    Args:
        workers: Number of processes; with 1, everything runs in this process.
        initializer: Function that is called once in every process.
        arguments: Arguments of the initializer.

    Raises:
        UsageError: If ``workers`` is not positive.
    """

    def __init__(
        self,
        workers: int,
        initializer: Callable[..., None] | None = None,
        arguments: tuple[Any, ...] = (),
    ) -> None:
        if workers < 1:
            raise UsageError(f"workers is {workers}, expected >= 1")
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        if workers > 1:
            first = Carried(), dict(os.environ), initializer, arguments
            context = process_context((initializer or _begin).__module__)
            self._pool = ProcessPoolExecutor(workers, context, _begin, first)
        elif initializer is not None:
            initializer(*arguments)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes when they have finished their present items."""
        if self._pool is not None:
            # At most a few items are in flight; an interrupted wait would hang at exit.
            with deaf_to_interrupts():
                self._pool.shutdown(wait=True, cancel_futures=True)

    def map(
        self, function: Callable[[T], R], items: Iterable[T], ahead: int = 4
    ) -> Iterator[R]:
        """Results in the order of ``items``, which may be endless.

        Args:
            function: Function that is importable by name, as other processes run it.
            items: Arguments of the function.
            ahead: Number of items handed out per worker in advance; an interrupt waits
                for those that have begun.

        Raises:
            WorkerDiedError: If a worker process dies.
        """
        if self._pool is None:
            yield from map(function, items)
            return
        remaining = iter(items)
        pending: deque[Future[R]] = deque()
        with _broken_pools_named(pending):
            pending += self._submit(function, islice(remaining, self._workers * ahead))
            while pending:
                result = pending.popleft().result()
                pending += self._submit(function, islice(remaining, 1))
                yield result

    def completed(
        self, function: Callable[[T], R], items: Iterable[T], ahead: int = 2
    ) -> Iterator[R]:
        """Results as they are ready; arguments and errors are those of ``map``."""
        if self._pool is None:
            yield from map(function, items)
            return
        remaining = iter(items)
        pending: set[Future[R]] = set()
        with _broken_pools_named(pending):
            pending |= set(
                self._submit(function, islice(remaining, self._workers * ahead))
            )
            while pending:
                done, rest = wait(pending, return_when=FIRST_COMPLETED)
                pending.intersection_update(rest)
                pending |= set(self._submit(function, islice(remaining, len(done))))
                yield from (future.result() for future in done)

    def _submit(
        self, function: Callable[[T], R], items: Iterable[T]
    ) -> list[Future[R]]:
        assert self._pool is not None
        # Pickled here: the pool's own thread meets an item that cannot be pickled, and
        # a pool that is closed meanwhile waits for that item forever.
        packed = [pickle.dumps((function, item)) for item in items]
        # Workers start here, and inherit the signal mask.
        with deaf_to_interrupts(), _dead_servers_named():
            return [self._pool.submit(_call, each) for each in packed]


def apart(
    function: Callable[[T], R], item: T, seconds: float, memory: int | None = None
) -> R:
    """Result of a function in a process of its own, which may crash or hang.

    Args:
        function: Function that is importable by name; its errors are raised here.
        item: Argument of the function.
        seconds: Longest time that it may take [s].
        memory: Largest address space beside what the process begins with [bytes]; None:
            any.

    Raises:
        WorkerDiedError: If the process crashed, took too long or asked for more memory.
    """
    context = process_context(function.__module__)
    receiver, sender = context.Pipe(duplex=False)
    arguments = Carried(), dict(os.environ), sender, memory, function, item
    process = context.Process(target=_send, args=arguments, daemon=True)
    with deaf_to_interrupts(), _dead_servers_named():
        process.start()
    sender.close()
    try:
        if not receiver.poll(seconds):
            raise WorkerDiedError(f"no end after {seconds:.0f} s")
        succeeded, value = receiver.recv()
    except EOFError:
        raise WorkerDiedError("the process crashed") from None
    finally:
        process.kill()
        process.join()
    if succeeded:
        return cast(R, value)
    raise value


@contextmanager
def _dead_servers_named() -> Iterator[None]:
    """Explain the failure if the fork server is dead when a process is asked for."""
    try:
        yield
    except (EOFError, ConnectionError) as error:
        raise WorkerDiedError(
            "the process that starts the workers died; is there enough memory?"
        ) from error


def _send(
    plugins: Any,
    environment: dict[str, str],
    sender: connection.Connection,
    memory: int | None,
    function: Callable[[T], R],
    item: T,
) -> None:
    _live_in(environment)
    if memory is not None:
        limit_memory(memory)
    try:
        sender.send((True, function(item)))
    except MemoryError:
        sender.send((False, WorkerDiedError("it needs more memory than it may have")))
    except Exception as error:
        sender.send((False, error))


@contextmanager
def _broken_pools_named(pending: Collection[Future[Any]]) -> Iterator[None]:
    """Explain the failure of a pool, and cancel waiting items when the block ends."""
    try:
        yield
    except BrokenProcessPool as error:
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
    _live_in(environment)
    if initializer is not None:
        initializer(*arguments)


def _call(packed: bytes) -> Any:
    function, item = pickle.loads(packed)
    return function(item)


def _live_in(environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


def ordered_map(
    function: Callable[[T], R],
    items: Iterable[T],
    workers: int,
    initializer: Callable[..., None] | None = None,
    arguments: tuple[Any, ...] = (),
    ahead: int = 4,
) -> Iterator[R]:
    """Results of a map over new ``Workers``, in the order of ``items``."""
    with Workers(workers, initializer, arguments) as pool:
        yield from pool.map(function, items, ahead)
