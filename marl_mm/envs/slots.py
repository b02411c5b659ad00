"""Places for many environments of one task: this process, its threads, or others.

Results do not depend on the place: every environment has a world and a stream of random
numbers of its own.
"""

import pickle
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain
from multiprocessing.sharedctypes import RawArray
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
from gymnasium.utils import seeding

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.pools import gathered, transferable
from marl_mm.workers import Residents

Backend = Literal["threads", "processes"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


MOST_THREADS = 4
"""Largest number of threads: a tenth of an episode's time is Python's, which only one
of them runs at a time."""


def threads_serve(task: Task, workers: int) -> bool:
    """Whether threads run a task's steps side by side, as compiled calls let them."""
    compiled = (
        task.simulation.engine != "bullet"
        and task.controller.solver == "active-set"
        and type(task).at_tick is Task.at_tick
        and not task.handles  # two threads make 1.5 times as many steps, processes 1.8
    )
    return compiled and workers <= MOST_THREADS


class Outcome(NamedTuple):
    """Result of an environment's step, beside its state."""

    reward: float
    """Reward of the step."""

    terminated: bool
    """Whether the step reached the goal or failed."""

    truncated: bool
    """Whether the episode ran out of steps."""

    info: dict[str, Any]
    """Step numbers by name."""

    final: np.ndarray | None
    """Joint state after the step if it ended the episode and another began, shape
    (n,)."""


class Slot:
    """One environment that begins another episode in the step that ends one.

    Args:
        task: The task.
        visual: Whether it can be rendered.
        state: Array to write joint states to, shape (n,).
    """

    def __init__(self, task: Task, visual: bool, state: np.ndarray) -> None:
        self._core = EpisodeCore(task, visual)
        self._state = state
        self._rng: np.random.Generator | None = None

    def reset(self, seed: int | None, goal: np.ndarray | None) -> None:
        """Begin an episode; without a seed the stream of random numbers goes on."""
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        self._state[:] = self._core.reset(self._rng, goal)

    def step(self, action: np.ndarray) -> Outcome:
        """Act for one step; see ``EpisodeCore.step``."""
        step = self._core.step(action)
        self._state[:] = step.state
        final = None
        if step.terminated or step.truncated:
            final = step.state
            self.reset(None, None)
        return Outcome(step.reward, step.terminated, step.truncated, step.info, final)

    def render(self) -> np.ndarray:
        """A picture, shape (h, w, 3), uint8."""
        return self._core.render(self._core.task.camera)

    def close(self) -> None:
        """Disconnect from the simulator."""
        self._core.close()


class Slots(Protocol):
    """Environments that are called all at once."""

    states: np.ndarray
    """Joint states, shape (environments, n), which calls overwrite."""

    def call(self, name: str, arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """Results of a method of ``Slot``, in the order of the environments.

        All are called even if one raises an error; then the first one's is raised.

        Args:
            name: Name of the method.
            arguments: Its arguments for each environment; None leaves one out.
        """

    def close(self) -> None:
        """End simulators, threads and processes; closing twice is harmless."""


class LocalSlots:
    """Environments in this process, in some threads.

    Args:
        task: The task.
        number: Number of environments.
        threads: Number of threads; 1 is this one.
        visual: Whether they can be rendered.
    """

    def __init__(self, task: Task, number: int, threads: int, visual: bool) -> None:
        self.states = np.zeros((number, len(task.layout.state)))
        self._slots = [Slot(task, visual, state) for state in self.states]
        self._thread_count = threads
        self._threads = ThreadPoolExecutor(threads) if threads > 1 else None

    def call(self, name: str, arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """See ``Slots``; a thread that is free takes the next environment."""
        calls = _calls(self._slots, name, arguments)
        if self._threads is None:
            return _results(map(_attempted, calls))
        attempts: list[Any] = [None] * len(calls)
        remaining = iter(enumerate(calls))  # which the threads share

        def work() -> None:
            for i, call in remaining:
                attempts[i] = _attempted(call)

        gathered([self._threads.submit(work) for _ in range(self._thread_count)])
        return _results(attempts)

    def close(self) -> None:
        """See ``Slots``."""
        if self._threads is not None:
            self._threads.shutdown()
        for slot in self._slots:
            slot.close()


class ProcessSlots:
    """Environments in other processes, several in each; states are in shared memory.

    Args:
        task: The task.
        number: Number of environments.
        processes: Number of processes, at most ``number``.
        visual: Whether they can be rendered.

    Raises:
        UsageError: If the task cannot be sent to another process.
    """

    def __init__(self, task: Task, number: int, processes: int, visual: bool) -> None:
        try:
            pickle.dumps(task)
            if not hasattr(sys.modules[type(task).__module__], "__file__"):
                raise TypeError("its class is of an interactive session")
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise UsageError(
                f"{type(task).__name__} cannot be sent to another process ({error}): "
                "define it in a module, or use `workers` 1"
            ) from None
        width = len(task.layout.state)
        memory = RawArray("d", number * width)
        self.states = np.frombuffer(memory).reshape(number, width)
        self._shares = np.array_split(range(number), processes)
        shares = [(task, visual, memory, share) for share in self._shares]
        self._residents = Residents(_move_in, shares)
        try:
            self._residents.call(_open, range(processes))
        except BaseException:
            self.close()
            raise

    def call(self, name: str, arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """See ``Slots``."""
        items = [(name, [arguments[i] for i in share]) for share in self._shares]
        return _results(chain.from_iterable(self._residents.call(_call, items)))

    def close(self) -> None:
        """See ``Slots``."""
        self._residents.close()


_Attempt = tuple[Any, Exception | None]
"""Result of a call, or its error."""


def _attempted(call: Callable[[], Any]) -> _Attempt:
    try:
        return call(), None
    except Exception as error:
        return None, error


def _results(attempts: Iterable[_Attempt]) -> list[Any]:
    """Results of calls; the first error is raised, if there is one."""
    attempts = list(attempts)
    for _, error in attempts:
        if error is not None:
            raise error
    return [result for result, _ in attempts]


def _calls(
    slots: Sequence[Slot], name: str, arguments: Sequence[tuple[Any, ...] | None]
) -> list[partial[Any]]:
    return [
        partial(getattr(slot, name), *each)
        for slot, each in zip(slots, arguments, strict=True)
        if each is not None
    ]


_share: tuple[Task, bool, Any, np.ndarray]
"""Arguments of a worker process."""

_slots: list[Slot]
"""Environments of a worker process."""


def _move_in(task: Task, visual: bool, memory: Any, share: np.ndarray) -> None:
    global _share
    _share = task, visual, memory, share


def _open(number: int) -> None:
    """Open the environments; not when the process begins, which hides errors."""
    global _slots
    task, visual, memory, share = _share
    states = np.frombuffer(memory).reshape(-1, len(task.layout.state))
    _slots = [Slot(task, visual, states[i]) for i in share]


def _call(item: tuple[str, list[tuple[Any, ...] | None]]) -> list[_Attempt]:
    attempts = map(_attempted, _calls(_slots, *item))
    return [(result, error and transferable(error)) for result, error in attempts]
