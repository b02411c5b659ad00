"""Comparison of two layouts, in words."""

from collections.abc import Sequence
from typing import Any

from marl_mm.errors import LayoutError
from marl_mm.layout import Agent, Layout


def refuse_other_layout(
    what: str, own: Layout, where: str, met: Layout, agents: bool = True
) -> None:
    """Raise if two layouts that have to be equal are not.

    Args:
        what: Name of the thing that brings its own layout, for the message.
        own: Its layout.
        where: Name of the thing it is used with, for the message.
        met: The layout of that.
        agents: Whether the agents are compared, too, or only the entries and the goal.

    Raises:
        LayoutError: Listing the entries that differ.
    """
    if own is met:
        return
    if changes := layout_diff(own, met, agents):
        raise LayoutError(
            f"{what} is made for another layout than {where} has: {'; '.join(changes)}"
        )


def layout_diff(own: Layout, other: Layout, agents: bool = True) -> list[str]:
    """Everything in which two layouts differ, in words; empty if they are equal.

    Args:
        own: The layout that is "here" in the words.
        other: The layout that is "there".
        agents: Whether the agents are compared, too, or only the entries and the goal.
    """
    changes = [
        *_changes("state", own.state, other.state),
        *_changes("action", own.action, other.action),
    ]
    for part in ("compared", "desired"):
        here, there = getattr(own, part), getattr(other, part)
        if here != there:
            changes.append(f"{part} {', '.join(here)} (there {', '.join(there)})")
    if agents:
        changes += _changes("agent", own.team, other.team)
    return changes


def _changes(part: str, own: Sequence[Any], others: Sequence[Any]) -> list[str]:
    """Entries or agents that are missing on one side, differ, or stand elsewhere."""
    here, there = ({item.name: item for item in side} for side in (own, others))
    found = [f"{part} {here[n]}: not there" for n in here if n not in there]
    found += [f"{part} {there[n]}: only there" for n in there if n not in here]
    for name in filter(there.__contains__, here):
        found += _unequal(part, here[name], there[name])
    if not found and list(here) != list(there):
        found = [f"order of the {part}: {', '.join(here)} (there {', '.join(there)})"]
    return found


def _unequal(part: str, own: Any, other: Any) -> list[str]:
    if own == other:
        return []
    if not isinstance(own, Agent):
        return [f"{part} {own} (there {other})"]
    found = []
    for verb in ("sees", "sets"):
        mine, theirs = getattr(own, verb), getattr(other, verb)
        lost = [f"{name} (not there)" for name in mine if name not in theirs]
        new = [f"{name} (only there)" for name in theirs if name not in mine]
        if changed := lost + new:
            found.append(f"{part} {own.name} {verb} {', '.join(changed)}")
        elif mine != theirs:
            found.append(f"{part} {own.name} {verb} the same in another order")
    return found
