"""Spaces of the joint observation and action, and of each agent's."""

import numpy as np
from gymnasium import spaces

from marl_mm.layout import Layout

_BOUNDS = {"control_mode": (0.0, 1.0), "opening": (-0.1, 0.1), "held": (0.0, 1.0)}
"""Of the state's entries that have any; the hand opens to 0.08 m."""


def _state_box(layout: Layout, entries: slice | tuple[int, ...]) -> spaces.Box:
    unbounded = -np.inf, np.inf
    low, high = np.array([_BOUNDS.get(name, unbounded) for name in layout.state]).T
    index = list(entries) if isinstance(entries, tuple) else entries
    return spaces.Box(low[index], high[index], dtype=np.float64)


def _action_box(layout: Layout, entries: tuple[int, ...]) -> spaces.Box:
    low = np.array(layout.low, np.float32)[list(entries)]
    high = np.array(layout.high, np.float32)[list(entries)]
    return spaces.Box(low, high, dtype=np.float32)


def state_space(layout: Layout) -> spaces.Box:
    """Joint state, shape (n,)."""
    return _state_box(layout, layout.joint.observation)


def action_space(layout: Layout) -> spaces.Box:
    """Joint action, shape (k,)."""
    return _action_box(layout, layout.joint.action)


def goal_observation_space(layout: Layout) -> spaces.Dict:
    """The joint state as a goal dictionary: observation (n - 3), two goals (3)."""
    return spaces.Dict(
        {
            "observation": _state_box(layout, layout.observation),
            "achieved_goal": _state_box(layout, layout.achieved),
            "desired_goal": _state_box(layout, layout.goal),
        }
    )


def agent_observation_spaces(layout: Layout) -> dict[str, spaces.Box]:
    """Each agent's part of the joint state, by name."""
    return {
        agent.name: _state_box(layout, agent.observation) for agent in layout.agents
    }


def agent_action_spaces(layout: Layout) -> dict[str, spaces.Box]:
    """Each agent's part of the joint action, by name."""
    return {agent.name: _action_box(layout, agent.action) for agent in layout.agents}
