"""Multi-agent offline reinforcement learning on a simulated mobile manipulator."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from marl_mm.envs.registry import TASKS
from marl_mm.plugins import load_installed

if TYPE_CHECKING:
    from marl_mm.datasets.dataset import load_dataset
    from marl_mm.envs import make_vec, parallel_vec
    from marl_mm.eval.studies.settings import Online, Probe, Setting
    from marl_mm.eval.studies.study import Study
    from marl_mm.runs.board import board
    from marl_mm.runs.collect import collect
    from marl_mm.runs.deriving import (
        filter_dataset,
        import_dataset,
        mix_datasets,
        split_dataset,
    )
    from marl_mm.runs.evaluate import evaluate
    from marl_mm.runs.export import export
    from marl_mm.runs.play import play
    from marl_mm.runs.policies import load_policy
    from marl_mm.runs.recipes import build_dataset
    from marl_mm.runs.robustness import cross_play, robustness
    from marl_mm.runs.run import find_runs, load_run
    from marl_mm.runs.sources import Mix, Source
    from marl_mm.runs.submit import submit
    from marl_mm.runs.train import repeat, train
    from marl_mm.runs.verify import verify

__version__ = "0.2.0"

__all__ = [
    "Mix",
    "Online",
    "Probe",
    "Setting",
    "Source",
    "Study",
    "board",
    "build_dataset",
    "collect",
    "cross_play",
    "evaluate",
    "export",
    "filter_dataset",
    "find_runs",
    "import_dataset",
    "load_dataset",
    "load_policy",
    "load_run",
    "make_vec",
    "mix_datasets",
    "parallel_vec",
    "play",
    "repeat",
    "robustness",
    "split_dataset",
    "submit",
    "train",
    "verify",
]

_MODULES = {
    **dict.fromkeys(
        ("Online", "Probe", "Setting", "Study"), "marl_mm.eval.studies.study"
    ),
    **dict.fromkeys(("Mix", "Source"), "marl_mm.runs.sources"),
    **dict.fromkeys(("cross_play", "robustness"), "marl_mm.runs.robustness"),
    **dict.fromkeys(("make_vec", "parallel_vec"), "marl_mm.envs"),
    **dict.fromkeys(
        ("filter_dataset", "import_dataset", "mix_datasets", "split_dataset"),
        "marl_mm.runs.deriving",
    ),
    "board": "marl_mm.runs.board",
    "build_dataset": "marl_mm.runs.recipes",
    "collect": "marl_mm.runs.collect",
    "evaluate": "marl_mm.runs.evaluate",
    "export": "marl_mm.runs.export",
    "find_runs": "marl_mm.runs.run",
    "load_dataset": "marl_mm.datasets.dataset",
    "load_policy": "marl_mm.runs.policies",
    "load_run": "marl_mm.runs.run",
    "play": "marl_mm.runs.play",
    "repeat": "marl_mm.runs.train",
    "submit": "marl_mm.runs.submit",
    "train": "marl_mm.runs.train",
    "verify": "marl_mm.runs.verify",
}
"""Modules of the public names: imported at their first use, as torch takes a second."""


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'marl_mm' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})


TASKS.names()  # registers them with Gymnasium, too
load_installed()
