"""Episodes of a policy, in order, in this process, its threads, or others.

The result depends on the plans alone. Every episode starts from a rebuilt world and
draws from its own seed, and results are returned in the order of the plans.
"""

import threading
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from gymnasium.utils import seeding

from marl_mm.envs.core import EpisodeCore, Step
from marl_mm.envs.drive import Watch
from marl_mm.envs.slots import threads_serve
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.policy import Policy
from marl_mm.sim.world import check_engine
from marl_mm.workers import Executor, Pool, Workers, open_pool

Purpose = Literal["collect", "evaluate", "train"]
PURPOSES: tuple[Purpose, ...] = get_args(Purpose)


@dataclass(frozen=True)
class EpisodePlan:
    """Plan of one episode."""

    index: int
    """Number of the episode in its collection or evaluation."""

    seed: int
    """Seed of the environment and, by a stream of its own, of the policy."""

    goal: tuple[float, ...] | None = None
    """Goal, shape (g,); None if the seed draws it."""


def episode_seed(seed: int, index: int, purpose: Purpose) -> int:
    """Seed of one episode, 63 bits, from the seed of the whole and its number.

    Evaluations do not start in the states of a dataset, as their purpose is another.
    """
    key = (PURPOSES.index(purpose), index)
    state = np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))


def run_episode(
    core: EpisodeCore,
    policy: Policy,
    plan: EpisodePlan,
    watch: Watch | None = None,
) -> Episode:
    """Run one episode to its end; ``watch`` is called after each tick."""
    rng, _ = seeding.np_random(plan.seed)
    layout = core.task.layout
    policy.begin(np.random.default_rng([plan.seed, 1]), layout)
    states = [core.reset(rng, None if plan.goal is None else np.array(plan.goal))]
    start = core.starts()
    actions: list[np.ndarray] = []
    steps: list[Step] = []
    while not steps or not (steps[-1].terminated or steps[-1].truncated):
        actions.append(core.bounded(policy.act(states[-1].copy())).astype(np.float32))
        steps.append(core.step(actions[-1], watch))
        states.append(steps[-1].state)
    return Episode(
        states=np.stack(states),
        actions=np.stack(actions),
        rewards=np.array([step.reward for step in steps]),
        terminated=np.array([step.terminated for step in steps]),
        truncated=np.array([step.truncated for step in steps]),
        info={
            key: np.array([step.info[key] for step in steps]) for key in core.task.info
        },
        layout=layout,
        seed=plan.seed,
        index=plan.index,
        source=policy.name,
        start=start,
        reason=steps[-1].info.get("reason"),
    )


class Rollouts:
    """Environments of one task that are kept for many policies, in a ``with`` block.

    Args:
        task: The task.
        workers: Number of processes, or of threads where a step is one compiled call;
            1 with "local" is this process.
        executor: Place of the processes: this machine, or a Ray cluster.

    Raises:
        UsageError: If ``workers`` is not positive, or Ray is not installed.
    """

    def __init__(
        self, task: Task, workers: int = 1, executor: Executor = "local"
    ) -> None:
        check_engine(task.simulation.engine)
        here = workers == 1 and executor == "local"
        self._core = EpisodeCore(task) if here else None
        self._pool: Pool | None = None
        if executor == "local" and workers > 1 and threads_serve(task, workers):
            self._pool = Workers(workers, _start_worker, (task,), threads=True)
        elif not here:
            self._pool = open_pool(executor, workers, _start_worker, (task,))

    def __enter__(self) -> "Rollouts":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End simulators and processes."""
        if self._core is not None:
            self._core.close()
        if self._pool is not None:
            self._pool.close()

    def run(self, policy: Policy, plans: Iterable[EpisodePlan]) -> Iterator[Episode]:
        """Run episodes and yield them in the order of ``plans``, which may be endless.

        Raises:
            WorkerDiedError: If a worker process dies.
        """
        if self._core is not None:
            for plan in plans:
                yield run_episode(self._core, policy, plan)
        if self._pool is not None:
            yield from self._pool.map(
                _run_in_worker, ((policy, plan) for plan in plans)
            )

    def train(
        self, seed: int, policy: Policy, numbers: Iterable[int]
    ) -> Iterator[Episode]:
        """Run the training episodes of a seed with these numbers; see ``run``."""
        plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in numbers]
        return self.run(policy, plans)

    def completed(
        self, policy: Policy, plans: Iterable[EpisodePlan]
    ) -> Generator[Episode, None, None]:
        """Run episodes and yield each as soon as it is finished."""
        if self._pool is None:
            yield from self.run(policy, plans)
        else:
            yield from self._pool.completed(
                _run_in_worker, ((policy, plan) for plan in plans)
            )


def run_episodes(
    task: Task, policy: Policy, plans: Iterable[EpisodePlan], workers: int = 1
) -> Iterator[Episode]:
    """Run episodes and yield them in the order of ``plans``; see ``Rollouts``."""
    with Rollouts(task, workers) as rollouts:
        yield from rollouts.run(policy, plans)


_worker = threading.local()
"""Task and environment of a worker, a process or a thread: ``task`` and ``core``."""


def _start_worker(task: Task) -> None:
    _worker.task = task


def _run_in_worker(item: tuple[Policy, EpisodePlan]) -> Episode:
    if not hasattr(_worker, "core"):  # not when the worker begins, which hides errors
        _worker.core = EpisodeCore(_worker.task)
    return run_episode(_worker.core, *item)
