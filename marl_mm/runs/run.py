"""A trained run: its folder, read when it is asked for."""

import html
import io
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.notebook import html_picture
from marl_mm.received import check_regular, read_json, refuse_links_out
from marl_mm.runs.evaluate import task_overrides
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    CONFIG,
    CURVE,
    EVALUATION,
    read_config,
    read_evaluation,
)
from marl_mm.runs.settings import as_path
from marl_mm.runs.submission import EPISODES
from marl_mm.sim.config import Engine, is_installed


@dataclass(frozen=True)
class Run:
    """A run's folder."""

    folder: Path
    """Folder with the run's config, metrics, checkpoints and evaluations."""

    @property
    def config(self) -> RunConfig:
        """The record of what the run is made of.

        Raises:
            CheckpointError: If it cannot be read.
        """
        return read_config(self.folder)

    @property
    def metrics(self) -> list[dict[str, Any]]:
        """Rows of ``metrics.jsonl``, in the order of the training."""
        return read_metrics(self.folder)

    @property
    def policy(self) -> LearnedPolicy:
        """The policy of the last checkpoint."""
        return load_policy(self.folder)

    @property
    def evaluation(self) -> Evaluation | None:
        """Evaluation of the last checkpoint; None before the training's end."""
        return read_evaluation(self.folder / EVALUATION)

    @property
    def evaluated(self) -> Evaluation:
        """Evaluation of the last checkpoint.

        Raises:
            UsageError: Before the training's end.
        """
        if (evaluation := self.evaluation) is None:
            raise UsageError(f"{self.folder} is not trained to its end: go on with it")
        return evaluation

    @property
    def best_evaluation(self) -> Evaluation | None:
        """Evaluation of an online run's best checkpoint; None where there is none."""
        return read_evaluation(self.folder / BEST_EVALUATION)

    def summary(self) -> str:
        """One line about the success of the last and the best checkpoint."""
        best = self.best_evaluation
        text = f"{self.folder}: {_success(self.evaluated)}"
        if best:
            text += f"; best checkpoint {_success(best)}"
        for row in self.metrics[-1:]:
            if row.get("updates") == 0:  # of an online run
                text += f"; no update in {row['env_steps']:,} steps: see `warm_up`"
        return text

    def film_strip(self, seed: int = 0) -> bytes:
        """Pictures of the policy's episodes on a seed's first goals, as a PNG."""
        from marl_mm.envs.registry import make_task
        from marl_mm.eval.video import draw_film_strip, strips_both_ways

        policy = self.policy
        if (key := (seed, policy.fingerprint)) in self._strips:
            return self._strips[key]
        max_steps = self.config.settings.get("max_steps")
        engine = cast(Engine, self.config.engine)
        task = make_task(self.config.task, task_overrides(max_steps, engine))
        picture = io.BytesIO()
        draw_film_strip(picture, strips_both_ways(task, policy, seed))
        self._strips[key] = picture.getvalue()
        return self._strips[key]

    @cached_property
    def _strips(self) -> dict[tuple[int, str], bytes]:
        """Film strips that are drawn already, by seed and the policy's fingerprint."""
        return {}

    def __repr__(self) -> str:
        config = self.config
        about = f"{config.algorithm} on {config.task}, seed {config.seed}"
        return f"<Run {self.folder}: {about}>"

    def _repr_html_(self) -> str:
        """Evaluation, learning curve and film strip, for notebooks."""
        parts = [f"<p>{html.escape(repr(self))}</p>"]
        if evaluation := self.evaluation:
            parts.append(evaluation._repr_html_())
        if (self.folder / CURVE).exists():
            refuse_links_out(self.folder, [CURVE], CheckpointError)
            check_regular(self.folder / CURVE, CheckpointError)
            parts.append(
                html_picture((self.folder / CURVE).read_bytes(), "learning curve")
            )
        if evaluation and is_installed("bullet"):  # which draws
            parts.append(html_picture(self.film_strip(), "film strip"))
        return "\n".join(parts)


def load_run(folder: str | Path) -> Run:
    """A run that was trained before.

    Raises:
        UsageError: If the folder holds none.
    """
    if not isinstance(folder, str | Path):
        raise UsageError(f"{folder!r:.80} is no folder, expected a run's")
    path = Path(folder)
    if not (path / CONFIG).exists():
        seeds = sorted(config.parent.name for config in path.glob(f"*/{CONFIG}"))
        hint = f": name one of its runs, such as {path / seeds[0]}" if seeds else ""
        raise UsageError(f"{path} is no run, it has no {CONFIG}{hint}")
    return Run(path)


def find_runs(folder: str | Path) -> list[Run]:
    """All runs below a folder, by name; folders that are links are not followed.

    Raises:
        UsageError: If there is no such folder.
    """
    root = as_path(folder, "folder", "one with runs in it")
    if not root.is_dir():
        raise UsageError(f"{root} is no folder, expected one with runs in it")
    # unlike `Path.rglob`, `os.walk` passes over a folder that is removed meanwhile
    inside = ((at, {*folders, *files}) for at, folders, files in os.walk(root))
    found = sorted(Path(at, CONFIG) for at, names in inside if CONFIG in names)
    return [Run(config.parent) for config in found if _is_of_a_run(config, root)]


def _is_of_a_run(config: Path, root: Path) -> bool:
    """Whether a file may be a run's record: not a sweep's, nor half of a folder."""
    if any(part.startswith(".") for part in config.relative_to(root).parts):
        return False
    if (config.parent / EPISODES).exists():
        return False  # a seed of a submission
    try:
        values = read_json(config, CheckpointError)
    except CheckpointError:  # a damaged run's, which is listed as such
        return True
    return not isinstance(values, dict) or "algorithm" in values


def _success(evaluation: Evaluation) -> str:
    everything = evaluation.summary["all"]
    low, high = (100 * bound for bound in everything["interval"])
    return (
        f"{100 * evaluation.success_rate:.1f} % of {everything['episodes']} goals "
        f"reached, 95 % interval [{low:.1f}, {high:.1f}]"
    )
