"""Many environments of a task for its agents: an array for each agent."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from marl_mm.envs.arguments import refuse_copies
from marl_mm.envs.parallel import AgentDict, join_actions, split_state
from marl_mm.envs.registry import DEFAULT
from marl_mm.envs.slots import Backend
from marl_mm.envs.vector import Seeds, TaskVector
from marl_mm.spaces import agent_action_spaces, agent_observation_spaces


class AgentVector(TaskVector):
    """``TaskVector`` whose observations are those of the agents, by agent.

    Its observation spaces are those of the joint states.
    """

    def _observation(self, states: np.ndarray) -> AgentDict:
        return split_state(states, self.task.layout)  # lists of columns make copies


class TeamVector:
    """Vector environment of ``parallel_env``, ``marl_mm.parallel_vec("Reach-v0", 8)``.

    Agents have spaces of their own; arrays have one row for each environment. It steps,
    resets and ends as ``make_vec`` does, whose arguments it has.
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
        self.vector = AgentVector(task, n, workers, overrides, render_mode, backend)
        layout = self.vector.task.layout
        self.task, self.num_envs = self.vector.task, n
        self.metadata = {**self.vector.metadata, "name": f"marl_mm/{task}"}
        self.render_mode = render_mode
        self.possible_agents = [agent.name for agent in layout.agents]
        self.agents = list(self.possible_agents)
        self.num_agents = len(self.agents)
        self.single_observation_spaces = agent_observation_spaces(layout)
        self.single_action_spaces = agent_action_spaces(layout)
        self.observation_spaces = _batched(self.single_observation_spaces, n)
        self.action_spaces = _batched(self.single_action_spaces, n)
        self.state_space = self.vector.single_observation_space

    __reduce__ = refuse_copies

    @property
    def unwrapped(self) -> "TeamVector":
        """Itself."""
        return self

    @property
    def closed(self) -> bool:
        """Whether it was closed."""
        return self.vector.closed

    def single_observation_space(self, agent: str) -> spaces.Box:
        """Space of an agent's observation in one environment."""
        return self.single_observation_spaces[agent]

    def single_action_space(self, agent: str) -> spaces.Box:
        """Space of an agent's action in one environment."""
        return self.single_action_spaces[agent]

    def observation_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """Space of an agent's observations, shape (n, d)."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """Space of an agent's actions, shape (n, k)."""
        return self.action_spaces[agent]

    def reset(
        self, seed: Seeds = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentDict, dict[str, dict[str, Any]]]:
        """Begin episodes; see ``TaskVector.reset``."""
        observations, _ = self.vector.reset(seed=seed, options=options)
        return observations, {agent: {} for agent in self.agents}

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[AgentDict, AgentDict, AgentDict, AgentDict, dict[str, dict[str, Any]]]:
        """Act for one step in every environment; those that end begin anew.

        Args:
            actions: Each agent's actions, shape (n, k), by agent.

        Returns:
            Observations, shape (n, d), rewards, terminations, truncations, shape (n,),
            and infos, by agent. Where an episode ended, ``final_obs`` of an agent's
            info is its last observation, and ``final_info`` the last info.

        Raises:
            InvalidActionError: If an agent is missing, or actions have another shape or
                are not finite; no environment has acted then.
            UsageError: If there was no ``reset()`` before, or none since a step that
                raised another error; or after ``close()``.
            MarlMmError: If the simulation diverged, or a number of the task is not
                finite.
            WorkerDiedError: If a worker process died; the vector is closed then.
        """
        self.vector.check_open()
        joint = join_actions(actions, self.task.layout, self.num_envs)
        observations, rewards, terminated, truncated, infos = self.vector.step(joint)
        return (
            observations,
            {agent: rewards.copy() for agent in self.agents},
            {agent: terminated.copy() for agent in self.agents},
            {agent: truncated.copy() for agent in self.agents},
            {agent: self._info(infos, agent) for agent in self.agents},
        )

    def state(self) -> np.ndarray:
        """Joint states, shape (n, d), as in the task's layout.

        Raises:
            UsageError: If no episode has begun.
        """
        return self.vector.state()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each, shape (h, w, 3), uint8; None without a render mode."""
        return self.vector.render()

    def close(self) -> None:
        """End simulators, threads and processes; closing twice is harmless."""
        self.vector.close()

    def _info(self, infos: dict[str, Any], agent: str) -> dict[str, Any]:
        """A copy of infos, with an agent's own final observations."""
        info = copy.deepcopy({k: v for k, v in infos.items() if k != "final_obs"})
        if "final_obs" in infos:
            finals = [final and final[agent] for final in infos["final_obs"]]
            info["final_obs"] = np.empty(self.num_envs, object)
            for i, final in enumerate(finals):
                info["final_obs"][i] = final
        return info


def _batched(
    single: Mapping[str, spaces.Box], n: int
) -> dict[str, spaces.Space[np.ndarray]]:
    return {agent: batch_space(space, n) for agent, space in single.items()}
