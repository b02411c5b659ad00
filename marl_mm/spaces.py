"""Spaces of the joint observation and action, and of each agent's."""

import numpy as np
from gymnasium import spaces

from marl_mm.layout import ACTION_HIGH, ACTION_LOW, AGENTS, MODE, STATE

_STATE_LOW = np.full(len(STATE), -np.inf)
_STATE_HIGH = np.full(len(STATE), np.inf)
_STATE_LOW[MODE], _STATE_HIGH[MODE] = 0.0, 1.0


def _state_box(entries: tuple[int, ...] | range) -> spaces.Box:
    index = list(entries)
    return spaces.Box(_STATE_LOW[index], _STATE_HIGH[index], dtype=np.float64)


def _action_box(entries: tuple[int, ...] | range) -> spaces.Box:
    low = np.array(ACTION_LOW, np.float32)[list(entries)]
    high = np.array(ACTION_HIGH, np.float32)[list(entries)]
    return spaces.Box(low, high, dtype=np.float32)


def state_space() -> spaces.Box:
    """Joint state, shape (10,)."""
    return _state_box(range(10))


def action_space() -> spaces.Box:
    """Joint action, shape (4,)."""
    return _action_box(range(4))


def goal_observation_space() -> spaces.Dict:
    """The joint state as a goal dictionary: observation (7), two goals (3)."""
    return spaces.Dict(
        {
            "observation": _state_box(range(7)),
            "achieved_goal": _state_box(range(3)),
            "desired_goal": _state_box(range(7, 10)),
        }
    )


def agent_observation_spaces() -> dict[str, spaces.Box]:
    """Each agent's part of the joint state, by name."""
    return {agent.name: _state_box(agent.observation) for agent in AGENTS}


def agent_action_spaces() -> dict[str, spaces.Box]:
    """Each agent's part of the joint action, by name."""
    return {agent.name: _action_box(agent.action) for agent in AGENTS}
