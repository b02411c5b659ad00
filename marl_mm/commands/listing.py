"""marl-mm algorithms, tasks, collectors and so on: lists of what is registered."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from marl_mm.commands.parser import parse_options
from marl_mm.declared import defaults
from marl_mm.envs.registry import config_dict

Row = dict[str, Any]


@dataclass(frozen=True)
class Listing:
    """List what there is, and where it comes from."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm KIND``, whose word is the first argument."""
    kind, *rest = arguments
    options = parse_options(Listing, f"marl-mm {kind}", rest)
    rows = list(_ROWS[kind]())
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    console = Console()
    if not console.is_terminal:  # whole sentences, for a search
        console = Console(width=200)
    console.print(table)


def _algorithms() -> Iterable[Row]:
    from marl_mm.algorithms.registry import ALGORITHMS

    for name, algorithm in ALGORITHMS.items():
        yield {
            "name": name,
            "learns": "online" if algorithm.online else "from a dataset",
            "about": algorithm.about,
            "source": algorithm.source,
            "presets": list(algorithm.presets),
            "from": ALGORITHMS.origin(name),
        }


def _tasks() -> Iterable[Row]:
    from marl_mm.envs.registry import TASKS

    for name, task in TASKS.items():
        yield {
            "name": name,
            "about": task.about,
            "numbers": _changed(task),
            "agents": [agent.name for agent in task.layout.team],
            "state": len(task.layout.state),
            "action": len(task.layout.action),
            "max_steps": task.max_steps,
            "from": TASKS.origin(name),
        }


def _collectors() -> Iterable[Row]:
    from marl_mm.collectors.registry import COLLECTORS

    for name, collector in COLLECTORS.items():
        yield {"name": name, "about": collector.about, "from": COLLECTORS.origin(name)}


def _formats() -> Iterable[Row]:
    from marl_mm.algorithms.export import POLICY_FORMATS
    from marl_mm.datasets.export import DATASET_FORMS
    from marl_mm.datasets.importing import IMPORTS

    for of, registry in (
        ("policies", POLICY_FORMATS),
        ("datasets, written", DATASET_FORMS),
        ("datasets, read", IMPORTS),
    ):
        for name, form in registry.items():
            yield {
                "name": name,
                "of": of,
                "about": form.about,
                "from": registry.origin(name),
            }


def _metrics() -> Iterable[Row]:
    from marl_mm.eval.metrics import METRICS

    for name, metric in METRICS.items():
        yield {"name": name, "about": metric.about, "from": METRICS.origin(name)}


_ROWS = {
    "algorithms": _algorithms,
    "tasks": _tasks,
    "collectors": _collectors,
    "formats": _formats,
    "metrics": _metrics,
}


def _changed(task: Any) -> dict[str, Any]:
    """Numbers of a task that are not its class's defaults."""
    usual = {name: config_dict(value) for name, value in defaults(type(task)).items()}
    own = config_dict(task)
    return {name: value for name, value in _changed_fields(usual, own)}


def _changed_fields(usual: Any, own: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in own.items():
        if isinstance(value, dict):
            yield from _changed_fields(usual[name], value, f"{path}{name}.")
        elif value != usual[name]:
            yield f"{path}{name}", value


def _text(value: Any) -> str:
    if isinstance(value, dict):
        value = [f"{name} {number}" for name, number in value.items()]
    return escape(", ".join(map(str, value)) if isinstance(value, list) else str(value))
