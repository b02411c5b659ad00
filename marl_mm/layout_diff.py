"""Comparison of two layouts, in words."""

from collections.abc import Sequence
from typing import Any

from marl_mm.errors import LayoutError
from marl_mm.layout import Agent, Layout


def refuse_other_layout(
    what: str, layout: Layout, where: str, other: Layout, agents: bool = True
) -> None:
    """Raise if two layouts that have to be equal are not.

    Args:
        what: Name of the thing that brings its own layout, for the message.
        layout: Its layout.
        where: Name of the thing it is used with, for the message.
        other: The layout of that.
        agents: Whether the agents are compared, too, or only the entries and the goal.

    Raises:
        LayoutError: Listing the entries that differ.
    """
    if layout is other:
        return
    if changes := layout_diff(layout, other, agents):
        raise LayoutError(
            f"{what} is made for another layout than {where} has: {'; '.join(changes)}"
        )


def layout_diff(layout: Layout, other: Layout, agents: bool = True) -> list[str]:
    """Everything in which two layouts differ, in words; empty if they are equal.

    Args:
        layout: The layout that is "here" in the words.
        other: The layout that is "there".
        agents: Whether the agents are compared, too, or only the entries and the goal.
    """
    changes = [
        *_changes("state", layout.state, other.state),
        *_changes("action", layout.action, other.action),
    ]
    for part in ("compared", "desired"):
        here, there = getattr(layout, part), getattr(other, part)
        if here != there:
            changes.append(f"{part} {', '.join(here)} (there {', '.join(there)})")
    if agents:
        changes += _changes("agent", layout.team, other.team)
    return changes


def _changes(part: str, items: Sequence[Any], others: Sequence[Any]) -> list[str]:
    """Entries or agents that are missing on one side, differ, or stand elsewhere."""
    here, there = ({item.name: item for item in side} for side in (items, others))
    lost = [str(here[name]) for name in here if name not in there]
    new = [str(there[name]) for name in there if name not in here]
    changes = [f"{part} {', '.join(lost)}: not there"] * bool(lost)
    changes += [f"{part} {', '.join(new)}: only there"] * bool(new)
    for name in filter(there.__contains__, here):
        changes += _unequal(part, here[name], there[name])
    if not changes and list(here) != list(there):
        changes = [f"order of the {part}: {', '.join(here)} (there {', '.join(there)})"]
    return changes


def _unequal(part: str, item: Any, other: Any) -> list[str]:
    if item == other:
        return []
    if not isinstance(item, Agent):
        return [f"{part} {item} (there {other})"]
    changes = []
    for verb in ("sees", "sets"):
        names, others = getattr(item, verb), getattr(other, verb)
        lost = [f"{name} (not there)" for name in names if name not in others]
        new = [f"{name} (only there)" for name in others if name not in names]
        if changed := lost + new:
            changes.append(f"{part} {item.name} {verb} {', '.join(changed)}")
        elif names != others:
            changes.append(f"{part} {item.name} {verb} the same in another order")
    return changes
