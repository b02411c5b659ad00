"""Layouts of files of version 1, which record less of them than today's files."""

from collections.abc import Mapping
from typing import Any

from marl_mm.envs.tasks import grasp, reach
from marl_mm.errors import LayoutError
from marl_mm.layout import Layout
from marl_mm.received import check_kind

_LAYOUTS = (reach.LAYOUT, grasp.LAYOUT)
"""All layouts of version 1."""


def dataset_layout(metadata: Mapping[str, Any]) -> Layout:
    """The layout of a dataset of schema 2, found by the names of its entries.

    Raises:
        LayoutError: If version 1 had none with these.
    """
    names: list[str] = []
    for part in ("state", "action"):
        check_kind(metadata.get(part), list[str], part, LayoutError)
        names += metadata[part]
    for layout in _LAYOUTS:
        if [*layout.state_names, *layout.action_names] == names:
            return layout
    raise LayoutError(f"no layout of version 1 has the entries {', '.join(names)}")


def checkpoint_layout(record: Mapping[str, Any]) -> Layout:
    """The layout of a checkpoint, found by its agents and the actions' bounds.

    Raises:
        LayoutError: If version 1 had none with these.
    """
    for layout in _LAYOUTS:
        agents = layout.agents
        expected = {
            "agents": [[a.name, list(a.observation), list(a.action)] for a in agents],
            "action_low": list(layout.low),
            "action_high": list(layout.high),
        }
        if expected == record:
            return layout
    raise LayoutError(f"no layout of version 1 is {record!s:.200}")
