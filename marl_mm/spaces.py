"""Gymnasium spaces of states and actions, joint and of each agent."""

import numpy as np
from gymnasium import spaces

from marl_mm.layout import AgentLayout, Columns, Layout


def _state_box(layout: Layout, entries: Columns) -> spaces.Box:
    low, high = np.array([(entry.low, entry.high) for entry in layout.state]).T
    return spaces.Box(low[entries], high[entries], dtype=np.float64)


def _action_box(agent: AgentLayout) -> spaces.Box:
    low, high = (np.array(bound, np.float32) for bound in (agent.low, agent.high))
    return spaces.Box(low, high, dtype=np.float32)


def state_space(layout: Layout) -> spaces.Box:
    """Space of the joint state, shape (n,), float64."""
    return _state_box(layout, slice(None))


def action_space(layout: Layout) -> spaces.Box:
    """Space of the joint action, shape (k,), float32."""
    return _action_box(layout.joint)


def goal_observation_space(layout: Layout) -> spaces.Dict:
    """Space of the joint state as a goal dictionary, shapes (n - g,), (g,) and (g,)."""
    return spaces.Dict(
        {
            "observation": _state_box(layout, layout.observation),
            "achieved_goal": _state_box(layout, layout.achieved),
            "desired_goal": _state_box(layout, layout.goal),
        }
    )


def agent_observation_spaces(layout: Layout) -> dict[str, spaces.Box]:
    """Spaces of the agents' observations, float64, by agent."""
    return {
        agent.name: _state_box(layout, list(agent.observation))
        for agent in layout.agents
    }


def agent_action_spaces(layout: Layout) -> dict[str, spaces.Box]:
    """Spaces of the agents' actions, float32, by agent."""
    return {agent.name: _action_box(agent) for agent in layout.agents}
