"""Workers on a Ray cluster; the only file that imports Ray."""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any, TypeVar

import ray

from marl_mm.errors import MarlMmError, UsageError, WorkerDiedError
from marl_mm.plugins import Carried

T = TypeVar("T")
R = TypeVar("R")


class RayWorkers:
    """Ray actors that are kept for many maps; use it in a ``with`` block.

    Args:
        workers: Number of actors, one CPU each; their nodes need marl_mm.
        initializer: Function that is called once in every actor.
        arguments: Arguments of the initializer.

    Raises:
        UsageError: If ``workers`` is not positive, or more than the cluster has CPUs.
        MarlMmError: If no cluster answers.
    """

    def __init__(
        self,
        workers: int,
        initializer: Callable[..., None] | None = None,
        arguments: tuple[Any, ...] = (),
    ) -> None:
        if workers < 1:
            raise UsageError(f"workers is {workers}, expected >= 1")
        self._started = not ray.is_initialized()
        if self._started:
            try:
                ray.init(log_to_driver=False, logging_level="ERROR")
            except (ConnectionError, RuntimeError, ValueError) as error:
                reason = " ".join(str(error).split())
                raise MarlMmError(f"no Ray cluster answers: {reason:.200}") from error
        self._actors: list[Any] = []
        cpus = int(ray.cluster_resources().get("CPU", 0))
        if workers > cpus:
            self.close()
            raise UsageError(f"workers is {workers}, the Ray cluster has {cpus} CPUs")
        kind = ray.remote(num_cpus=1)(_Worker)
        self._actors = [
            kind.remote((Carried(), initializer, arguments)) for _ in range(workers)
        ]

    def __enter__(self) -> "RayWorkers":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the actors, and Ray if it was started here."""
        for actor in self._actors:
            ray.kill(actor)
        if self._started:
            ray.shutdown()

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results in the order of ``items``; see ``Workers.map``."""
        waiting: dict[int, R] = {}
        following = 0
        numbered = _Numbered(function)
        for number, result in self.completed(numbered, enumerate(items)):
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1

    def completed(
        self, function: Callable[[T], R], items: Iterable[T], ahead: int = 2
    ) -> Iterator[R]:
        """Results as they come; see ``Workers.completed``."""
        remaining = iter(items)
        busy: dict[Any, Any] = {}  # actor of each pending result
        for actor in self._actors * ahead:
            for item in islice(remaining, 1):
                busy[actor.call.remote(function, item)] = actor
        while busy:
            (done,), _ = ray.wait(list(busy), num_returns=1)
            actor = busy.pop(done)
            for item in islice(remaining, 1):
                busy[actor.call.remote(function, item)] = actor
            try:
                yield ray.get(done)
            except ray.exceptions.RayTaskError as error:
                if isinstance(error.cause, MarlMmError):
                    raise error.cause from None
                raise
            except ray.exceptions.RayError as error:
                reason = " ".join(str(error).split())
                raise WorkerDiedError(f"a Ray worker died: {reason:.200}") from error


class _Worker:
    """A process of the cluster."""

    def __init__(
        self, first: tuple[Any, Callable[..., None] | None, tuple[Any, ...]]
    ) -> None:
        _, initializer, arguments = first
        if initializer is not None:
            initializer(*arguments)

    def call(self, function: Callable[[T], R], item: T) -> R:
        """The function's result."""
        return function(item)


class _Numbered:
    """A function of (number, item) that gives (number, result)."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function

    def __call__(self, item: tuple[int, Any]) -> tuple[int, Any]:
        number, value = item
        return number, self._function(value)
