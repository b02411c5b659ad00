"""A task as a Gymnasium goal environment: one agent sets the joint action."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import logger, spaces

from marl_mm.envs.arguments import (
    RENDER_MODES,
    check_render_mode,
    checked_options,
    checked_seed,
    refuse_copies,
    render_metadata,
)
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.task import Terms
from marl_mm.episode import FAILED
from marl_mm.errors import UsageError
from marl_mm.layout import Layout
from marl_mm.spaces import action_space, goal_observation_space

GoalObservation = dict[str, np.ndarray]
Infos = Mapping[str, Any] | Sequence[Mapping[str, Any]]


def goal_observation(state: np.ndarray, layout: Layout) -> GoalObservation:
    """Joint states, shape (..., n), as a goal dictionary."""
    return {
        "observation": state[..., layout.observation].copy(),
        "achieved_goal": state[..., layout.achieved].copy(),
        "desired_goal": state[..., layout.goal].copy(),
    }


class GoalEnv(gymnasium.Env[GoalObservation, np.ndarray]):
    """Goal environment, ``gymnasium.make("marl_mm/Reach-v0")``.

    ``Task.info`` lists the entries of a step's ``info`` with their units.

    Args:
        task: Registered name of the task.
        overrides: Fields of the task to replace, JSON-serialisable.
        render_mode: ``"rgb_array"`` or None.
    """

    metadata = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(
        self,
        task: str = DEFAULT,
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.task = make_task(task, overrides)
        self.metadata = render_metadata(self.task)
        self.core = EpisodeCore(self.task, visual=render_mode is not None)
        self._over = False
        layout = self.task.layout
        self.observation_space = cast(
            spaces.Space[GoalObservation], goal_observation_space(layout)
        )
        self.action_space = action_space(layout)

    __reduce__ = refuse_copies

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Seed of the random numbers; without one their stream goes on.
            options: ``"goal"``, shape (g,), is the goal, in the units of its entries.

        Raises:
            UsageError: If an argument makes no sense, or after ``close()``.
        """
        self.core.check_open()
        goal = checked_options(options, self.task.layout).get("goal")
        super().reset(seed=checked_seed(seed))
        state = self.core.reset(self.np_random, goal)
        self._over = False
        return goal_observation(state, self.task.layout), {}

    def step(
        self, action: np.ndarray
    ) -> tuple[GoalObservation, float, bool, bool, dict[str, Any]]:
        """Act for one step; see ``EpisodeCore.step``.

        After an episode's end it warns, as Gymnasium's own environments do.
        """
        if self._over:
            logger.warn("step() was called after the episode's end: call reset()")
        state, reward, terminated, truncated, info = self.core.step(action)
        self._over = terminated or truncated
        observation = goal_observation(state, self.task.layout)
        return observation, reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """The reward of a step with other goals, shapes (..., g) to (...).

        Args:
            achieved_goal: Entries that are compared with the goal, after the step.
            desired_goal: Goal to judge the step by.
            info: The step's info, or a sequence with one per row of the goals.
        """
        goals = np.asarray(achieved_goal), np.asarray(desired_goal)
        return self.task.reward(*goals, self._terms(info))

    def compute_terminated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """Whether a step would have ended the episode with other goals, shape (...)."""
        goals = np.asarray(achieved_goal), np.asarray(desired_goal)
        _, ended = self.task.judge(*goals, self._terms(info))
        return np.asarray(ended)

    def compute_truncated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """False, shape (...): goals never truncate an episode, the step count does."""
        return np.zeros(np.shape(achieved_goal)[:-1], bool)

    def render(self) -> np.ndarray | None:
        """A picture, shape (height, width, 3), uint8; None without a render mode."""
        return self.core.render(self.task.camera) if self.render_mode else None

    def close(self) -> None:
        """Disconnect from the simulator."""
        self.core.close()

    def _terms(self, info: Infos) -> Terms:
        terms = {name: _gathered(info, name) for name in self.task.needs}
        failed = np.asarray(False)
        if self.task.fails:  # reasons are words, or none
            failed = _gathered(info, "reason").astype(object).astype(bool)
        return {**terms, FAILED: failed}


def _gathered(info: Infos, key: str) -> np.ndarray:
    try:
        if isinstance(info, Mapping):
            return np.asarray(info[key])
        return np.array([single[key] for single in info])
    except KeyError:
        raise UsageError(
            f"info lacks {key!r}, which the reward depends on: pass the step's own; "
            "Stable-Baselines3 keeps it with HerReplayBuffer(copy_info_dict=True), "
            "replay_buffer_kwargs={'copy_info_dict': True}"
        ) from None
