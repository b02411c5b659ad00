"""Spaces of the joint observation and action, and of each agent's."""

import numpy as np
from gymnasium import spaces

from marl_mm.layout import AgentLayout, Columns, Layout


def _state_box(layout: Layout, entries: Columns) -> spaces.Box:
    low, high = np.array([(one.low, one.high) for one in layout.state]).T
    return spaces.Box(low[entries], high[entries], dtype=np.float64)


def _action_box(agent: AgentLayout) -> spaces.Box:
    low, high = (np.array(one, np.float32) for one in (agent.low, agent.high))
    return spaces.Box(low, high, dtype=np.float32)


def state_space(layout: Layout) -> spaces.Box:
    """Joint state, shape (n,)."""
    return _state_box(layout, slice(None))


def action_space(layout: Layout) -> spaces.Box:
    """Joint action, shape (k,)."""
    return _action_box(layout.joint)


def goal_observation_space(layout: Layout) -> spaces.Dict:
    """The joint state as a goal dictionary: observation (n - g), two goals (g)."""
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
        agent.name: _state_box(layout, list(agent.observation))
        for agent in layout.agents
    }


def agent_action_spaces(layout: Layout) -> dict[str, spaces.Box]:
    """Each agent's part of the joint action, by name."""
    return {agent.name: _action_box(agent) for agent in layout.agents}
