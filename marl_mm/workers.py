"""A function over many items, in this process or in several."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import FIRST_COMPLETED, Future, wait
from importlib.util import find_spec
from itertools import islice, repeat
from multiprocessing import connection
from typing import Any, Literal, Protocol, TypeVar, cast

from marl_mm.errors import UsageError, WorkerDiedError
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.plugins import Carried
from marl_mm.pools import (
    broken_pools_named,
    close,
    dead_servers_named,
    gathered,
    live_in,
    opened,
    submit,
    transferable,
)
from marl_mm.processes import (
    check_importable,
    limit_memory,
    process_context,
    starting,
)

T = TypeVar("T")
R = TypeVar("R")

Executor = Literal["local", "ray"]

_MOST = 64
"""Largest number of processes where four for each core are fewer."""


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


def check_workers(workers: int) -> None:
    """Raise for a number of processes that this machine cannot have.

    Raises:
        UsageError: If it is not positive, or many times the number of cores.
    """
    cores = available_cores()
    most = max(_MOST, 4 * cores)
    if not 1 <= workers <= most:
        raise UsageError(
            f"workers is {workers}, expected 1 to {most}: there are {cores} cores"
        )


class Pool(Protocol):
    """Worker processes, of this machine or of a cluster."""

    def close(self) -> None:
        """End the processes."""

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results in the order of ``items``, which may be endless."""

    def completed(
        self, function: Callable[[T], R], items: Iterable[T], ahead: int = 2
    ) -> Iterator[R]:
        """Results in the order in which they are ready; see ``Workers.map``."""


def check_place(executor: Executor, workers: int) -> None:
    """Raise for processes that cannot be had where they are asked for.

    Raises:
        UsageError: If this machine cannot have as many, or Ray is not installed.
    """
    if executor == "local":
        check_workers(workers)
    elif find_spec("ray") is None:
        raise UsageError("ray is missing: pip install -e '.[ray]'")


def open_pool(
    executor: Executor,
    workers: int,
    initializer: Callable[..., None] | None,
    arguments: tuple[Any, ...],
) -> Pool:
    """Processes of this machine, or of a Ray cluster.

    Raises:
        UsageError: If ``workers`` is not positive, or Ray is not installed.
    """
    check_place(executor, workers)
    if executor == "local":
        return Workers(workers, initializer, arguments)
    from marl_mm.ray_workers import RayWorkers

    return RayWorkers(workers, initializer, arguments)


class Workers:
    """Processes that are kept for many maps; use it in a ``with`` block.

    Args:
        workers: Number of processes; with 1, everything runs in this process.
        initializer: Function that is called once in every process.
        arguments: Arguments of the initializer.
        threads: Have threads of this process, for functions that leave others be.

    Raises:
        UsageError: If ``workers`` is not positive, or many times the number of cores.
    """

    def __init__(
        self,
        workers: int,
        initializer: Callable[..., None] | None = None,
        arguments: tuple[Any, ...] = (),
        threads: bool = False,
    ) -> None:
        check_workers(workers)
        self._workers = workers
        self._pool: futures.Executor | None = None
        if workers > 1:
            self._pool = opened(workers, initializer, arguments, threads)
        elif initializer is not None:
            initializer(*arguments)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes when they have finished their present items."""
        if self._pool is not None:
            close([self._pool])

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
        with broken_pools_named(pending):
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
        with broken_pools_named(pending):
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
        return submit(repeat(self._pool), function, items)


class Residents:
    """Processes that keep what their functions store between calls.

    Args:
        initializer: Function that is called once in every process.
        arguments: Arguments of the initializer in each process.
    """

    def __init__(
        self,
        initializer: Callable[..., None],
        arguments: Sequence[tuple[Any, ...]],
    ) -> None:
        self._pools = [opened(1, initializer, each) for each in arguments]

    def call(self, function: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """Results of a function that runs in every process at once.

        Args:
            function: Function that is importable by name.
            items: Its argument in each process.

        Raises:
            WorkerDiedError: If a process died.
        """
        pending: list[Future[R]] = []
        with broken_pools_named(pending):
            pending += submit(self._pools, function, items)
            return gathered(pending)

    def close(self) -> None:
        """End the processes when they have finished their present calls."""
        close(self._pools)


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
    check_importable([item])
    context = process_context(function.__module__)
    receiver, sender = context.Pipe(duplex=False)
    arguments = Carried(), dict(os.environ), sender, memory, function, item
    process = context.Process(target=_send, args=arguments, daemon=True)
    with deaf_to_interrupts(), dead_servers_named(), starting():
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
        receiver.close()
    if succeeded:
        return cast(R, value)
    raise value


def _send(
    plugins: Any,
    environment: dict[str, str],
    sender: connection.Connection,
    memory: int | None,
    function: Callable[[T], R],
    item: T,
) -> None:
    live_in(environment)
    if memory is not None:
        limit_memory(memory)
    try:
        sender.send((True, function(item)))
    except MemoryError:
        sender.send((False, WorkerDiedError("it needs more memory than it may have")))
    except Exception as error:
        sender.send((False, transferable(error)))
