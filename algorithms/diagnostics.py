"""Diagnostics of actors and critics, which a run logs beside its losses."""

import torch

from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.layout import Layout

DIAGNOSED = 1_024
"""Number of transitions that diagnostics use."""

_SATURATED = 0.98
"""Absolute value beyond which an action counts as saturated, in [-1, 1] coordinates."""


def saturation(action: torch.Tensor) -> torch.Tensor:
    """Share of entries near their bounds, shapes (..., n, k) to (...)."""
    return (action.abs() > _SATURATED).float().mean(dim=(-2, -1))


def imitation_errors(
    now: torch.Tensor, action: torch.Tensor, layout: Layout
) -> dict[str, torch.Tensor]:
    """Mean square difference to actions of the data by entry, and saturation.

    Args:
        now: The actors' actions in [-1, 1], shape (S, n, k), or (S, n, h k) of chunks,
            whose first action the errors are of.
        action: Actions of the data in [-1, 1], likewise.
        layout: Layout of the actions.
    """
    errors = (now - action).square().mean(dim=1)
    names = layout.action_names
    return {
        **{f"imitation/{name}": errors[:, i] for i, name in enumerate(names)},
        "action/saturation": saturation(now),
    }


def value_slope(
    critics: SeededCritics,
    state: torch.Tensor,
    inputs: torch.Tensor,
    action: torch.Tensor,
    layout: Layout,
) -> dict[str, torch.Tensor]:
    """Value of the largest step towards the goal less that of one away, along x.

    Other entries of the action are the data's. Below 0 the critic has learnt the
    opposite.

    Args:
        critics: Critics, whose first is asked.
        state: Joint states, shape (1, n, d).
        inputs: The same normalised, shape (S, n, d).
        action: Actions of the data in [-1, 1], shape (S, n, k).
        layout: Layout of states and actions.

    Returns:
        ``q/slope``, shape (S,); empty where the layout lacks ``delta_x`` or ``goal_x``.
    """
    if "delta_x" not in layout.action_names or "goal_x" not in layout.desired:
        return {}
    compared = layout.compared[layout.desired.index("goal_x")]
    goal, position = (layout.state_names.index(name) for name in ("goal_x", compared))
    direction = torch.sign(state[..., goal] - state[..., position])
    along = layout.action_names.index("delta_x")
    towards, away = action.clone(), action.clone()
    towards[..., along], away[..., along] = direction, -direction
    slope = critics.first(inputs, towards) - critics.first(inputs, away)
    return {"q/slope": slope.mean(dim=1)}
