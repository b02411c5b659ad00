"""A task as a PettingZoo parallel environment: its agents share one reward."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from marl_mm.envs.arguments import (
    check_render_mode,
    checked_options,
    checked_seed,
    refuse_copies,
    render_metadata,
)
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import InvalidActionError, UsageError
from marl_mm.layout import Layout
from marl_mm.spaces import (
    agent_action_spaces,
    agent_observation_spaces,
    state_space,
)

AgentDict = dict[str, np.ndarray]


def split_state(state: np.ndarray, layout: Layout) -> AgentDict:
    """Each agent's observation of a joint state, shape (..., n), by agent."""
    return {agent.name: state[..., list(agent.observation)] for agent in layout.agents}


def split_action(action: np.ndarray, layout: Layout) -> AgentDict:
    """Each agent's part of the joint action, shape (..., k), by agent."""
    return {agent.name: action[..., list(agent.action)] for agent in layout.agents}


def join_actions(
    actions: Mapping[str, np.ndarray], layout: Layout, *batch: int
) -> np.ndarray:
    """The joint actions, float64, shape (*batch, k), of the agents' actions.

    Raises:
        InvalidActionError: If they are no mapping, an agent is missing, or its actions
            have another shape or are no numbers.
    """
    if not isinstance(actions, Mapping):
        raise InvalidActionError(
            f"actions are {actions!r:.60}, expected each agent's by its name: "
            "`marl_mm.envs.parallel.split_action` takes joint ones apart"
        )
    joint = np.zeros((*batch, len(layout.action)))
    for agent in layout.agents:
        if agent.name not in actions:
            raise InvalidActionError(
                f"no action for agent {agent.name!r}, got {sorted(actions)}"
            )
        try:
            action = np.asarray(actions[agent.name], dtype=np.float64)
        except (TypeError, ValueError):
            raise InvalidActionError(
                f"action of agent {agent.name!r} is {actions[agent.name]!r:.60}, "
                "expected numbers"
            ) from None
        shape = *batch, len(agent.action)
        if action.shape != shape:
            raise InvalidActionError(
                f"action of agent {agent.name!r} has shape {action.shape}, expected "
                f"{shape}"
            )
        joint[..., list(agent.action)] = action
    return joint


class TeamEnv(ParallelEnv[str, np.ndarray, np.ndarray]):
    """Parallel environment, ``marl_mm.envs.parallel_env("Reach-v0")``.

    Args:
        task: Registered name of the task.
        overrides: Fields of the task to replace, JSON-serialisable.
        render_mode: ``"rgb_array"`` or None.
    """

    def __init__(
        self,
        task: str = DEFAULT,
        overrides: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.task = make_task(task, overrides)
        self.metadata = {
            "name": f"marl_mm/{task}",
            "is_parallelizable": True,
            **render_metadata(self.task),
        }
        self.core = EpisodeCore(self.task, visual=render_mode is not None)
        layout = self.task.layout
        self.possible_agents = [agent.name for agent in layout.agents]
        self.agents: list[str] = []
        self.observation_spaces = agent_observation_spaces(layout)
        self.action_spaces = agent_action_spaces(layout)
        self.state_space = state_space(layout)
        self._rng, _ = seeding.np_random()
        self._joint: np.ndarray | None = None

    __reduce__ = refuse_copies

    def observation_space(self, agent: str) -> spaces.Box:
        """Space of an agent's observation; the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """Space of an agent's action; the same object at each call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentDict, dict[str, dict[str, Any]]]:
        """Begin an episode; arguments and errors are those of ``GoalEnv.reset``."""
        self.core.check_open()
        goal = checked_options(options, self.task.layout).get("goal")
        if (checked := checked_seed(seed)) is not None:
            self._rng, _ = seeding.np_random(checked)
        state = self.core.reset(self._rng, goal)
        self._joint, self.agents = state, list(self.possible_agents)
        return split_state(state, self.task.layout), {
            agent: {} for agent in self.agents
        }

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        AgentDict,
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Act for one step; rewards, ends and infos are the same for all agents.

        Raises:
            InvalidActionError: If an agent is missing, or an action has another shape
                or is not finite.
            MarlMmError: As ``EpisodeCore.step`` does.
        """
        self.core.check_open()
        if self._joint is None:
            raise UsageError("step() was called before reset()")
        if not self.agents:
            return {}, {}, {}, {}, {}
        outcome = self.core.step(join_actions(actions, self.task.layout))
        self._joint, agents = outcome.state, self.agents
        if outcome.terminated or outcome.truncated:
            self.agents = []
        return (
            split_state(outcome.state, self.task.layout),
            dict.fromkeys(agents, outcome.reward),
            dict.fromkeys(agents, outcome.terminated),
            dict.fromkeys(agents, outcome.truncated),
            {agent: dict(outcome.info) for agent in agents},
        )

    def state(self) -> np.ndarray:
        """The joint state, shape (n,), as in the task's layout.

        Raises:
            UsageError: If no episode has begun.
        """
        if self._joint is None:
            raise UsageError("state() was called before reset()")
        return self._joint.copy()

    def render(self) -> np.ndarray | None:
        """A picture, shape (height, width, 3), uint8; None without a render mode."""
        return self.core.render(self.task.camera) if self.render_mode else None

    def close(self) -> None:
        """Disconnect from the simulator."""
        self.core.close()
