"""Many environments of a task as one Gymnasium vector environment."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from marl_mm.envs.arguments import (
    check_render_mode,
    checked_options,
    checked_seed,
    refuse_copies,
    render_metadata,
)
from marl_mm.envs.goal_env import GoalObservation, goal_observation
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.slots import (
    BACKENDS,
    Backend,
    LocalSlots,
    Outcome,
    ProcessSlots,
    Slots,
    threads_serve,
)
from marl_mm.envs.task import Task
from marl_mm.errors import InvalidActionError, UsageError, WorkerDiedError
from marl_mm.layout import Layout
from marl_mm.sim.world import check_engine
from marl_mm.spaces import action_space, goal_observation_space, state_space
from marl_mm.workers import available_cores, check_workers

Seeds = int | Sequence[int | None] | None


class TaskVector(VectorEnv[Any, np.ndarray, np.ndarray]):
    """Environments of a task whose observations are joint states, shape (n, d).

    Arguments, resets and ends are those of ``GoalVector``.
    """

    def __init__(
        self,
        task: str = DEFAULT,
        n: int = 1,
        workers: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        backend: Backend | None = None,
    ) -> None:
        check_render_mode(render_mode)
        workers = available_cores() if workers is None else workers
        for name, number in {"n": n, "workers": workers}.items():
            whole = isinstance(number, int | np.integer)
            if not whole or isinstance(number, bool) or number < 1:
                raise UsageError(f"{name} is {number!r}, expected an integer >= 1")
        check_workers(min(workers, n))
        self.task = make_task(task, overrides)
        self.num_envs, self.render_mode = int(n), render_mode
        self.metadata = {
            **render_metadata(self.task),
            "autoreset_mode": AutoresetMode.SAME_STEP,
        }
        self.single_action_space = action_space(self.task.layout)
        self.single_observation_space = self._space(self.task.layout)
        self.action_space = batch_space(self.single_action_space, n)
        self.observation_space = batch_space(self.single_observation_space, n)
        self._seeds: list[int | None] = [None] * n
        self._begun = np.zeros(n, bool)
        self._slots = _opened(
            self.task, n, min(workers, n), render_mode is not None, backend
        )

    __reduce__ = refuse_copies

    def _space(self, layout: Layout) -> spaces.Space[Any]:
        """Space of one environment's observation."""
        return state_space(layout)

    def _observation(self, states: np.ndarray) -> Any:
        """Observation of joint states, shape (..., d)."""
        return states.copy()

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """Seed that each environment was last reset with; None before the first."""
        return tuple(self._seeds)

    def reset(
        self, *, seed: Seeds = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: Seed s of the first environment, s + i that of number i; or a seed, or
                None, for each. Without a seed, streams of random numbers go on.
            options: ``"goal"``, shape (g,), is the goal of all episodes that begin
                now; those that follow draw theirs. ``"reset_mask"``, bool, shape (n,),
                tells which begin one.

        Raises:
            UsageError: If a seed, the goal or the mask makes no sense, or after
                ``close()``.
            WorkerDiedError: If a worker process died; the vector is closed then.
        """
        self.check_open()
        asked = checked_options(options, self.task.layout, "reset_mask")
        seeds = self._checked_seeds(seed)
        mask = self._checked_mask(asked.get("reset_mask"))
        arguments: list[tuple[Any, ...] | None] = [None] * self.num_envs
        for i in np.flatnonzero(mask):
            if seeds[i] is None and self._seeds[i] is None:
                seeds[i] = seeding.np_random()[1]
            arguments[i] = seeds[i], asked.get("goal")
        self._call("reset", arguments)
        for i in np.flatnonzero(mask):
            self._seeds[i] = self._seeds[i] if seeds[i] is None else seeds[i]
        return self._observation(self._slots.states), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Act for one step in every environment; those that end begin anew.

        Args:
            actions: Joint actions, shape (n, k).

        Returns:
            Observations, rewards, terminations, truncations and infos. Where an episode
            ended, the observation is the next one's first, and ``final_obs`` and
            ``final_info`` are the last of the one that ended.

        Raises:
            InvalidActionError: If actions have another shape or are not finite; no
                environment has acted then.
            MarlMmError: As ``EpisodeCore.step`` does.
            UsageError: If there was no ``reset()`` before, or since a step that raised
                an error; or after ``close()``.
            WorkerDiedError: If a worker process died; the vector is closed then.
        """
        self.check_open()
        if not self._begun.all():
            raise UsageError("step() was called before reset()")
        outcomes = self._call("step", [(a,) for a in self._checked(actions)])
        rewards, terminated, truncated, _, _ = zip(*outcomes, strict=True)
        return (
            self._observation(self._slots.states),
            np.array(rewards),
            np.array(terminated),
            np.array(truncated),
            self._infos(outcomes),
        )

    def state(self) -> np.ndarray:
        """Joint states, shape (n, d), as in the task's layout.

        Raises:
            UsageError: If no episode has begun.
        """
        if None in self._seeds:
            raise UsageError("state() was called before reset()")
        return self._slots.states.copy()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each, shape (h, w, 3), uint8; None without a render mode."""
        self.check_open()
        if not self.render_mode:
            return None
        return tuple(self._called("render", [()] * self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """End simulators, threads and processes."""
        if hasattr(self, "_slots"):  # Gymnasium 1.1 closes what was refused, too
            self._slots.close()

    def _call(self, name: str, arguments: list[tuple[Any, ...] | None]) -> list[Any]:
        """Call all environments; after an error they have to be reset."""
        begun, self._begun = self._begun, np.zeros(self.num_envs, bool)
        results = self._called(name, arguments)
        self._begun = begun | np.array([each is not None for each in arguments])
        return results

    def _called(self, name: str, arguments: list[tuple[Any, ...] | None]) -> list[Any]:
        """Call all environments; if a worker died, it is closed."""
        try:
            return self._slots.call(name, arguments)
        except WorkerDiedError:
            self.close()
            raise

    def _infos(self, outcomes: Sequence[Outcome]) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for i, outcome in enumerate(outcomes):
            info = outcome.info
            if outcome.final is not None:
                final = self._observation(outcome.final)
                info = {"final_obs": final, "final_info": info}
            infos = self._add_info(infos, info, i)
        return infos

    def check_open(self) -> None:
        """Raise after ``close()``.

        Raises:
            UsageError: If it was closed.
        """
        if self.closed:
            raise UsageError("the environment is closed: make another")

    def _checked_seeds(self, seed: Seeds) -> list[int | None]:
        number = self.num_envs
        if isinstance(seed, Sequence) or (isinstance(seed, np.ndarray) and seed.ndim):
            seeds = [checked_seed(each) for each in seed]
        else:
            first = checked_seed(seed)
            seeds = [None if first is None else first + i for i in range(number)]
        if len(seeds) != number:
            raise UsageError(
                f"seed is {seed!r}, expected an integer >= 0, or {number} of them"
            )
        return seeds

    def _checked_mask(self, mask: Any) -> np.ndarray:
        everyone = np.ones(self.num_envs, bool)
        if mask is None:
            return everyone
        try:
            values = np.asarray(mask)
        except ValueError:
            values = np.asarray(None)
        if values.shape != everyone.shape or values.dtype != bool or not values.any():
            raise UsageError(
                f"reset_mask is {mask!r:.60}, expected {self.num_envs} truth values, "
                "one of them true"
            )
        return values

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        shape = self.action_space.shape
        try:
            values = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError):
            raise InvalidActionError(
                f"actions are {actions!r:.60}, expected numbers, shape {shape}"
            ) from None
        if values.shape != shape:
            raise InvalidActionError(
                f"actions have shape {values.shape}, expected {shape}: environments, "
                f"then {', '.join(self.task.layout.action_names)}"
            )
        if odd := np.flatnonzero(~np.isfinite(values).all(1)).tolist():
            raise InvalidActionError(
                f"action of environment {odd[0]} is {values[odd[0]].tolist()}, "
                "expected finite numbers: check the policy's input for NaN"
            )
        return values


class GoalVector(TaskVector):
    """Vector environment of ``GoalEnv``, ``marl_mm.make_vec("Reach-v0", 8)``.

    Every number is that of n single environments to the last bit, whatever the workers.
    Up to four workers are threads where a step is one compiled call (engine
    ``"mujoco"``, no blocks); they are processes elsewhere, with some of the
    environments in each.

    Args:
        task: Registered name of the task.
        n: Number of environments.
        workers: Number of threads or processes; 1 is this process. Default: one for
            each core.
        overrides: Fields of the task to replace, JSON-serialisable.
        render_mode: ``"rgb_array"`` or None.
        backend: ``"threads"`` or ``"processes"``; default as above.

    Raises:
        UsageError: If an argument makes no sense, the engine is not installed, or the
            task cannot be sent to a process.
    """

    def _space(self, layout: Layout) -> spaces.Space[Any]:
        return goal_observation_space(layout)

    def _observation(self, states: np.ndarray) -> GoalObservation:
        return goal_observation(states, self.task.layout)


def _opened(
    task: Task, n: int, workers: int, visual: bool, backend: Backend | None
) -> Slots:
    """Environments where they run side by side.

    Raises:
        UsageError: If there is no such backend, or threads would share PyBullet.
    """
    bullet = visual or task.simulation.engine == "bullet"
    if backend is None:
        serve = threads_serve(task, workers) and not visual
        backend = "threads" if serve else "processes"
    elif backend not in BACKENDS:
        raise UsageError(
            f"backend is {backend!r}, expected {' or '.join(BACKENDS)}, or None"
        )
    elif backend == "threads" and bullet:
        raise UsageError(
            "backend is 'threads', but PyBullet simulates or renders, which runs in "
            "one thread only: use 'processes'"
        )
    check_engine(task.simulation.engine)
    if workers == 1 or backend == "threads":
        return LocalSlots(task, n, workers, visual)
    return ProcessSlots(task, n, workers, visual)
