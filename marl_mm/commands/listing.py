"""marl-mm algorithms, tasks, collectors and so on: lists of what is registered."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from marl_mm.commands.output import print_rows
from marl_mm.commands.parser import run
from marl_mm.declared import defaults
from marl_mm.envs.registry import config_dict
from marl_mm.registry import Registry

Row = dict[str, Any]


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm KIND``, whose word is the first argument."""
    kind, *rest = arguments

    def listing(*, json: bool = False) -> None:
        """List what there is, and where it comes from.

        Args:
            json: Print JSON.
        """
        print_rows(list(_ROWS[kind]()), json)

    run(listing, f"marl-mm {kind}", rest)


def _about(item: Any) -> Row:
    return {"about": item.about}


def _rows(
    registry: Registry[Any], describe: Callable[[Any], Row] = _about
) -> Iterator[Row]:
    for name, item in registry.items():
        yield {"name": name, **describe(item), "from": registry.origin(name)}


def _algorithms() -> Iterator[Row]:
    from marl_mm.algorithms.registry import ALGORITHMS

    def describe(algorithm: Any) -> Row:
        return {
            "learns": "online" if algorithm.online else "from a dataset",
            "about": algorithm.about,
            "source": algorithm.source,
            "presets": list(algorithm.presets),
        }

    return _rows(ALGORITHMS, describe)


def _tasks() -> Iterator[Row]:
    from marl_mm.envs.registry import TASKS

    def describe(task: Any) -> Row:
        return {
            "about": task.about,
            "numbers": _changed(task),
            "agents": [agent.name for agent in task.layout.team],
            "state": len(task.layout.state),
            "action": len(task.layout.action),
            "max_steps": task.max_steps,
        }

    return _rows(TASKS, describe)


def _collectors() -> Iterator[Row]:
    from marl_mm.collectors.registry import COLLECTORS

    return _rows(COLLECTORS)


def _formats() -> Iterator[Row]:
    from marl_mm.algorithms.export import POLICY_FORMATS
    from marl_mm.datasets.export import DATASET_FORMS
    from marl_mm.datasets.importing import IMPORTS

    registries: Mapping[str, Registry[Any]] = {
        "policies": POLICY_FORMATS,
        "datasets, written": DATASET_FORMS,
        "datasets, read": IMPORTS,
    }
    for of, registry in registries.items():
        for row in _rows(registry):
            yield {"name": row["name"], "of": of, **row}


def _metrics() -> Iterator[Row]:
    from marl_mm.eval.metrics import METRICS

    return _rows(METRICS)


_ROWS = {
    "algorithms": _algorithms,
    "tasks": _tasks,
    "collectors": _collectors,
    "formats": _formats,
    "metrics": _metrics,
}


def _changed(task: Any) -> Row:
    """Numbers of a task that are not its class's defaults."""
    usual = {name: config_dict(value) for name, value in defaults(type(task)).items()}
    return dict(_changed_fields(usual, config_dict(task)))


def _changed_fields(usual: Any, own: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in own.items():
        if isinstance(value, dict):
            yield from _changed_fields(usual[name], value, f"{path}{name}.")
        elif value != usual[name]:
            yield f"{path}{name}", value
