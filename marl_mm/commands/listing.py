"""marl-mm algorithms, tasks, collectors and so on: lists of what is registered."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from marl_mm.commands.output import print_rows
from marl_mm.commands.parser import run
from marl_mm.declared import defaults
from marl_mm.envs.registry import config_dict
from marl_mm.registry import Registry

Row = dict[str, Any]

_REGISTRIES = {
    "algorithms": {"": "algorithms.registry:ALGORITHMS"},
    "tasks": {"": "envs.registry:TASKS"},
    "collectors": {"": "collectors.registry:COLLECTORS"},
    "formats": {
        "policies": "algorithms.export_formats:POLICY_FORMATS",
        "datasets, written": "datasets.export:DATASET_FORMS",
        "datasets, read": "datasets.import_forms:IMPORTS",
    },
    "metrics": {"": "eval.metrics:METRICS"},
}
"""Registries by kind and sort, imported when they are listed."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm KIND``, whose word is the first argument."""
    kind, *rest = arguments

    def listing(*, json: bool = False) -> None:
        """List what is registered, and where it comes from.

        Args:
            json: Print JSON.
        """
        print_rows([*_rows(kind)], json)

    run(listing, f"marl-mm {kind}", rest)


def _rows(kind: str) -> Iterator[Row]:
    for sort, place in _REGISTRIES[kind].items():
        module, _, attribute = place.partition(":")
        registry: Registry[Any] = getattr(import_module(f"marl_mm.{module}"), attribute)
        for name, item in registry.items():
            row = ({"of": sort} if sort else {}) | _describe(kind, item)
            yield {"name": name, **row, "from": registry.origin(name)}


def _describe(kind: str, item: Any) -> Row:
    """What a list shows of a registered object, beside its name and origin."""
    if kind == "algorithms":
        return {
            "learns": item.learns,
            "about": item.about,
            "source": item.source,
            "presets": list(item.presets),
        }
    if kind == "tasks":
        return {
            "about": item.about,
            "numbers": _changed(item),
            "agents": [agent.name for agent in item.layout.team],
            "state": len(item.layout.state),
            "action": len(item.layout.action),
            "max_steps": item.max_steps,
        }
    return {"about": item.about}


def _changed(task: Any) -> Row:
    """Numbers of a task that are not its class's defaults."""
    usual = {name: config_dict(value) for name, value in defaults(type(task)).items()}
    return dict(_changed_fields(usual, config_dict(task)))


def _changed_fields(base: Any, task: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in task.items():
        if isinstance(value, dict):
            yield from _changed_fields(base[name], value, f"{path}{name}.")
        elif value != base[name]:
            yield f"{path}{name}", value
