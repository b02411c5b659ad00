"""The reach tasks as a Gymnasium goal environment: one agent sets the joint action."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces

from marl_mm.envs.config import reach_config
from marl_mm.envs.core import RENDER_MODES, ReachCore, check_render_mode
from marl_mm.envs.terms import goal_distance, reach_reward, reached
from marl_mm.layout import layout_of
from marl_mm.sim.config import Camera
from marl_mm.spaces import action_space, goal_observation_space

GoalObservation = dict[str, np.ndarray]
Infos = Mapping[str, Any] | Sequence[Mapping[str, Any]]


def goal_observation(state: np.ndarray) -> GoalObservation:
    """The joint state, shape (n,), as a goal dictionary."""
    layout = layout_of(len(state))
    return {
        "observation": state[layout.observation].copy(),
        "achieved_goal": state[layout.achieved].copy(),
        "desired_goal": state[layout.goal].copy(),
    }


class ReachEnv(gymnasium.Env[GoalObservation, np.ndarray]):
    """Goal environment, ``gymnasium.make("marl_mm/Reach-v0")``.

    ``info`` of a step is listed with its units in ``marl_mm.episode.INFO``.

    Args:
        task: A registered task's name.
        overrides: Fields of its ``ReachConfig`` to replace, JSON-serialisable.
        render_mode: ``"rgb_array"`` or None.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 1}  # noqa: RUF012

    def __init__(
        self,
        task: str = "Reach-v0",
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.config = reach_config(task, overrides)
        self.core = ReachCore(self.config, visual=render_mode is not None)
        self.observation_space = cast(
            spaces.Space[GoalObservation], goal_observation_space(self.config.layout)
        )
        self.action_space = action_space(self.config.layout)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Begin an episode; ``options={"goal": (x, y, z)}`` sets the goal [m]."""
        super().reset(seed=seed)
        state = self.core.reset(self.np_random, (options or {}).get("goal"))
        return goal_observation(state), {}

    def step(
        self, action: np.ndarray
    ) -> tuple[GoalObservation, float, bool, bool, dict[str, Any]]:
        """Act for one second; see ``ReachCore.step``."""
        state, reward, terminated, truncated, info = self.core.step(action)
        return goal_observation(state), reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """The reward a step would have had with other goals, shapes (..., 3) to (...).

        Args:
            achieved_goal: Where end-effector, or block, is after the step [m].
            desired_goal: Goal to judge it by [m].
            info: The step's info, or one per row of the goals.
        """
        return reach_reward(
            goal_distance(achieved_goal, desired_goal),
            _gathered(info, "d_mm"),
            _gathered(info, "d_mp"),
            _gathered(info, "base_jerk_rms"),
            self.config,
            *self._failed_and_held(info),
        )

    def compute_terminated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """Whether a step would have ended the episode with other goals."""
        distance = goal_distance(achieved_goal, desired_goal)
        failed, held = self._failed_and_held(info)
        return np.asarray(reached(distance, self.config, held) | failed)

    def _failed_and_held(self, info: Infos) -> tuple[np.ndarray, np.ndarray]:
        """Whether steps failed, and whether a block was held, where there is one."""
        if self.config.load is None:
            return np.asarray(False), np.asarray(True)
        return _true(_gathered(info, "reason")), _true(_gathered(info, "held"))

    def compute_truncated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Infos
    ) -> np.ndarray:
        """Goals never truncate an episode; the step count does."""
        return np.zeros(np.shape(achieved_goal)[:-1], bool)

    def render(self) -> np.ndarray | None:
        """A picture, shape (height, width, 3), in mode ``"rgb_array"``."""
        if self.render_mode != "rgb_array":
            return None
        return self.core.drive.world.render(Camera())

    def close(self) -> None:
        """Disconnect from the simulator."""
        self.core.close()


def _gathered(info: Infos, key: str) -> np.ndarray:
    if isinstance(info, Mapping):
        return np.asarray(info[key])
    return np.array([single[key] for single in info])


def _true(values: np.ndarray) -> np.ndarray:
    """Of reasons, which are words or none, and of flags."""
    truth: np.ndarray = values.astype(object).astype(bool)
    return truth
