"""Policies by name: runs, the agent that ships, and collectors."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.task import Task
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.policy import Policy
from marl_mm.received import read_json
from marl_mm.runs.settings import check_config, with_settings
from marl_mm.sim.config import RECORDED_ENGINE, Engine, default_engine

AGENT = "pretrained"
"""Name of the agent that ships, which needs no run folder."""


def policy_names() -> tuple[str, ...]:
    """Policies that need no run folder: the agent that ships, and all collectors'."""
    return AGENT, *(name for name in COLLECTORS.names() if name != AGENT)


def load_policy(
    source: Any, task: str | Task = DEFAULT, config: Any = None, **settings: Any
) -> Policy:
    """A policy of a run, of the agent that ships, or of a collector.

    Args:
        source: Run, run folder, checkpoint file, ``pretrained``, a collector's name, or
            a policy, which is returned.
        task: Task that a collector's policy is to act in.
        config: Settings of a collector's policy; default the collector's.
        **settings: Settings of a collector's policy, by name.

    Raises:
        UsageError: If it is none of these, or has no such setting.
        CheckpointError: If a run's checkpoint is damaged.
    """
    if isinstance(source, str) and source != AGENT and source in COLLECTORS:
        collector = COLLECTORS.get(source)
        own = collector.config()
        config = own if config is None else config
        check_config(config, own)
        config = with_settings(f"collector {source}", config, settings)
        instance = make_task(task) if isinstance(task, str) else task
        return collector.policy(config, instance)
    if settings or config is not None:
        raise UsageError(
            f"{source!s:.80} takes no settings, got {', '.join(settings or ['config'])}"
            ": they are for collectors' policies"
        )
    if all(hasattr(source, name) for name in ("name", "describe", "begin", "act")):
        policy: Policy = source
        return policy
    path = getattr(source, "folder", source)
    if not isinstance(path, str | Path):
        raise UsageError(
            f"{source!r:.80} is no policy, expected a run, its folder, a checkpoint "
            f"file, {', '.join(policy_names())}, or an object with `name`, `describe`, "
            "`begin` and `act`"
        )
    if path != AGENT and not Path(path).exists():
        raise UsageError(
            f"no policy {str(path)!r}: expected {', '.join(policy_names())}, a run "
            "folder or a checkpoint file"
        )
    from marl_mm.algorithms import policy as learned  # torch takes a second to import

    return learned.load_policy(path)


def own_task(policies: Sequence[Any]) -> str:
    """The task that all runs among some policies are for; without runs the default.

    Args:
        policies: Sources as in ``load_policy``.

    Raises:
        UsageError: If there are several tasks.
    """
    return _of_runs(policies, "task", DEFAULT) or DEFAULT


def own_engine(policies: Sequence[Any]) -> Engine:
    """The engine of all runs among some policies; without runs the default.

    Args:
        policies: Sources as in ``load_policy``.

    Raises:
        UsageError: If there are several engines.
    """
    engine = _of_runs(policies, "engine", RECORDED_ENGINE)
    return cast(Engine, engine or default_engine())


def _of_runs(policies: Sequence[Any], key: str, unnamed: str) -> str | None:
    """What all runs among some policies have in their records; None without runs.

    Args:
        policies: Sources as in ``load_policy``.
        key: Key of the record.
        unnamed: Value of records without the key.
    """
    values: dict[str, Any] = {}
    for source in policies:
        if hasattr(source, "act") or source in policy_names():
            continue
        path = getattr(source, "folder", source)
        if not isinstance(path, str | Path):
            continue  # load_policy refuses it
        path = Path(path)
        config = (path.parent if path.is_file() else path) / "config.json"
        if config.exists():
            record = read_json(config, CheckpointError)
            value = record.get(key, unnamed) if isinstance(record, dict) else None
            if not isinstance(value, str):
                raise CheckpointError(f"{config} is damaged: {key} is {value!r:.60}")
            values[value] = path
    if len(values) > 1:
        listed = ", ".join(
            f"{name} for {value}" for value, name in sorted(values.items())
        )
        raise UsageError(f"runs for several {key}s, {listed}: choose one with `{key}`")
    return next(iter(values), None)
