"""Collect a dataset."""

import re
from pathlib import Path
from typing import Any

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.card import keep_card
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.journal import noted
from marl_mm.datasets.location import locate, text_of
from marl_mm.datasets.provenance import Provenance
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collecting import Collecting, collect_dataset, recorded
from marl_mm.runs.settings import (
    check_config,
    flat,
    refuse_unknown,
    setting_names,
    with_settings,
    with_values,
)
from marl_mm.runs.sources import task_folder
from marl_mm.sim.config import engine_of


def collect(
    collector: str = "pd",
    *,
    task: str | None = None,
    dataset: str | Path | None = None,
    config: Any = None,
    progress: Bar = silent_bar,
    **settings: Any,
) -> Dataset:
    """Collect a dataset with a scripted or a learnt policy.

    Args:
        collector: Name of a registered collector.
        task: Registered name of the task; default Reach-v0, or when resuming that of
            the dataset.
        dataset: Id below ``$MINARI_DATASETS_PATH``, or path; default
            ``marl_mm/TASK/COLLECTOR-v0``, of ``pretrained`` ``marl_mm/TASK/good-v0``.
        config: Settings of the collector; default its own, or when resuming those that
            the dataset was begun with.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        **settings: Fields of ``Collecting`` (``steps``, ``seed``, ``workers``,
            ``resume`` ...) and of the collector's config, by name.

    Raises:
        UsageError: If a setting makes no sense, or the dataset exists.
        OtherConfigError: If the dataset to resume was collected otherwise.
        KeyboardInterrupt: After Ctrl-C; the dataset holds the episodes until then.
    """
    defaults = COLLECTORS.get(collector).config()
    name = default_dataset(task or DEFAULT, collector) if dataset is None else dataset
    if not isinstance(name, str | Path):
        raise UsageError(f"`dataset` is {name!r:.80}, expected an id or a path")
    name = text_of(name)
    saved = begun_settings(name, collector) if settings.get("resume") else {}
    record = f"the record of {name}"
    if config is None:
        config = with_values(defaults, saved, record, DatasetError)
    check_config(config, defaults)
    asked = {} if task is None else {"task": task}
    collecting = with_values(Collecting(), saved, record, DatasetError)
    collecting = with_settings("collect", collecting, asked)
    collector_values = {k: v for k, v in settings.items() if not hasattr(collecting, k)}
    known = [*setting_names(collecting), *setting_names(defaults)]
    refuse_unknown(f"collect with {collector}", collector_values, known)
    common_values = {k: v for k, v in settings.items() if k not in collector_values}
    data, complete = collect_into(
        name,
        collector,
        with_settings(f"collector {collector}", config, collector_values),
        with_settings("collect", collecting, common_values),
        progress,
    )
    if not complete:
        raise KeyboardInterrupt(
            "stopped; the dataset holds the episodes until then: go on with "
            "`resume=True`"
        )
    return data


def collect_into(
    name: str, collector: str, config: Any, collecting: Collecting, bar: Bar
) -> tuple[Dataset, bool]:
    """Collect a dataset and keep its card; see ``collect``.

    Returns:
        The dataset, and whether it is complete: Ctrl-C may have come before.
    """
    location = locate(name)
    collection = collect_dataset(location, collector, config, collecting, bar=bar)
    data = load_dataset(location)
    keep_card(data)
    return data, collection.complete


def begun_settings(name: str, collector: str) -> dict[str, Any]:
    """Settings, by name, that a collector began a dataset with; none without one."""
    location = locate(name)
    about = noted(location.working)
    begun = Provenance.from_json(about) if about else recorded(location)
    if begun is None or begun.collector != collector:
        return {}
    engine = engine_of(begun.overrides)
    settings = {"task": begun.task, "seed": begun.seed, "engine": engine}
    return settings | {**begun.overrides, **flat(begun.collector_config or {})}


def default_dataset(task: str, collector: str) -> str:
    """Id of a collector's dataset of a task where nobody names another.

    Raises:
        UsageError: If there is no such task or collector.
    """
    TASKS.get(task)
    name = COLLECTORS.get(collector).dataset or collector
    name = re.sub(r"[^a-zA-Z0-9_-]", "-", name)
    return f"marl_mm/{task_folder(task)}/{name}-v0"
