"""A submission: seeds of one setting that anybody can score again, without any code.

Its folder has a folder per seed with weights, record, rows and hashes of episodes, and
a manifest with the SHA-256 of each file.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.pretrained import WEIGHTS, load_pretrained
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.config_diff import as_json, changes
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import EpisodePlan
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import SubmissionError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.goals import goal_set
from marl_mm.eval.intervals import interval_of_mean, wider_interval
from marl_mm.eval.metrics import EvaluationRow, episode_row
from marl_mm.received import Refusal, check_kind, check_regular, file_digest, read_json
from marl_mm.runs.folder import CONFIG, EVALUATION, read_config, read_evaluation
from marl_mm.runs.training import SWITCHES
from marl_mm.sim.config import as_recorded

MANIFEST = "manifest.json"
MEANS = "success_rate", "interval", "summary"
"""Values of an evaluation that follow from its rows, and that a submission's lacks."""

EPISODES = "episodes.json"
FORMAT = "marl_mm submission 1"

FILES = (WEIGHTS, CONFIG, EVALUATION, EPISODES)
"""Files of each seed."""

MOST_GOALS = 2_000
"""Largest number of goals."""

FILE_BYTES = 100_000_000
"""Largest size of a file [bytes]."""

_EPISODES: dict[str, Any] = {"sha256": list[str], "first_action": list[list[float]]}
"""Types of what is kept of episodes beside their rows."""

OF_A_SEED = (
    *("seed", "preset", "packages", "plugins", "plugins_before", "device", "start"),
    "start_sha256",
    *("eval_episodes", "eval_seed", "curve_episodes", "curve_every", "layout"),
    *("weights_sha256", *SWITCHES),
)
"""Values of records in which the seeds of a submission may differ."""


@dataclass(frozen=True)
class Scored:
    """An episode as a submission keeps it."""

    row: EvaluationRow
    """Row of the evaluation."""

    sha256: str
    """SHA-256 of the episode's states, actions and rewards, in hex digits."""

    first_action: list[float]
    """Joint action of the first step, which tells weights apart on any processor."""


def scored(episode: Episode) -> Scored:
    """An episode's row, hash and first action."""
    digest = hashlib.sha256()
    for values in (episode.states, episode.actions, episode.rewards):
        digest.update(np.ascontiguousarray(values).tobytes())
    return Scored(episode_row(episode), digest.hexdigest(), episode.actions[0].tolist())


@dataclass(frozen=True)
class SubmittedRun:
    """A seed of a submission."""

    folder: Path
    """Folder with the weights."""

    config: RunConfig
    """Record of the run."""

    evaluation: Evaluation
    """Rows of the episodes."""

    episodes: list[Scored]
    """Episodes, in the order of the goals."""

    @cached_property
    def policy(self) -> LearnedPolicy:
        """The policy of the weights.

        Raises:
            CheckpointError: If they are damaged.
        """
        return load_pretrained(self.folder)


@dataclass(frozen=True)
class Submission:
    """Seeds of one setting, whose files are those of the manifest."""

    folder: Path
    """Folder of the submission."""

    manifest: Mapping[str, Any]
    """Setting, claims, versions, machine, and SHA-256 of each file."""

    runs: tuple[SubmittedRun, ...]
    """Seeds, in order."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all that is submitted, in hex digits."""
        return str(self.manifest["fingerprint"])

    @property
    def task(self) -> Task:
        """Task of the episodes, on their engine."""
        evaluation = self.runs[0].evaluation
        return make_task(evaluation.task, as_recorded(evaluation.overrides))

    @property
    def plans(self) -> list[EpisodePlan]:
        """Plans of the episodes."""
        evaluation = self.runs[0].evaluation
        return goal_set(self.task, len(evaluation.rows), evaluation.seed)

    def scores(self, name: str) -> np.ndarray:
        """A number of the rows by seed and goal, shape (seeds, goals)."""
        return _scores(self.runs, name)

    def __repr__(self) -> str:
        return f"<Submission {self.folder}: {self.in_words()}>"

    def in_words(self) -> str:
        """The claims in a line."""
        claims, goals = self.manifest["claims"], self.manifest["goals"]
        low, high = (100 * bound for bound in claims["success_interval"])
        seeds = "1 seed" if len(self.runs) == 1 else f"{len(self.runs)} seeds"
        return (
            f"{self.manifest['algorithm']} on {self.manifest['task']}, "
            f"{seeds}: {100 * claims['success']:.1f} % of "
            f"{goals['count']} goals reached, 95 % interval [{low:.1f}, {high:.1f}]"
        )


def _scores(runs: Sequence[SubmittedRun], name: str) -> np.ndarray:
    rows = [[episode.row for episode in run.episodes] for run in runs]
    return np.array([[float(row[name]) for row in each] for each in rows])  # type: ignore[literal-required]


def described(runs: Sequence[SubmittedRun]) -> dict[str, Any]:
    """What the manifest says of seeds: the setting, and what follows from the rows."""
    config, evaluation = runs[0].config, runs[0].evaluation
    success, returns = _scores(runs, "success"), _scores(runs, "return")
    rates = [float(rate) for rate in success.mean(axis=1)]
    return {
        "algorithm": config.algorithm,
        "task": config.task,
        "overrides": dict(evaluation.overrides),
        "engine": evaluation.engine,
        "dataset": config.dataset and dict(config.dataset),
        "seeds": [run.config.seed for run in runs],
        "goals": {"count": success.shape[1], "seed": evaluation.seed},
        "claims": {
            "success": float(np.mean(rates)),
            "success_interval": list(wider_interval(rates, success.shape[1])),
            "success_seeds": rates,
            "return": float(returns.mean()),
            "return_interval": list(interval_of_mean(returns)),
        },
    }


def seal(manifest: Mapping[str, Any]) -> str:
    """Fingerprint of a manifest: SHA-256 of all its other values."""
    values = {name: v for name, v in manifest.items() if name != "fingerprint"}
    text = json.dumps(values, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def files_of(folder: Path, seeds: Sequence[int]) -> dict[str, str]:
    """SHA-256 of each file of the seeds, by its path in the folder.

    Raises:
        SubmissionError: If one is missing, none, or too large.
    """
    names = [f"{seed}/{name}" for seed in seeds for name in FILES]
    for name in names:
        check_regular(folder / name, SubmissionError, FILE_BYTES)
    return {name: file_digest(folder / name, SubmissionError) for name in names}


def refuse_mixed(configs: Sequence[tuple[str, RunConfig]], refusal: Refusal) -> None:
    """Raise for records of other settings than the first one's, or of one seed twice.

    Args:
        configs: Names of folders, and the records in them.
        refusal: Class of the error.
    """
    seeds: dict[int, str] = {}
    first: dict[str, Any] = {}
    for name, config in configs:
        if config.seed in seeds:
            raise refusal(
                f"{seeds[config.seed]} and {name} are both of seed {config.seed}, "
                "expected each seed once"
            )
        seeds[config.seed] = name
        values = config.to_json()
        for key in OF_A_SEED:
            values.pop(key, None)
        if data := config.dataset:
            values["dataset"] = [data.get("id"), data.get("fingerprint")]
        first = first or values
        absent = {key: None for key in first.keys() - values.keys()}
        if differing := list(changes(as_json(first), as_json(absent | values))):
            raise refusal(
                f"{name} is of another setting than {configs[0][0]}, which was made "
                f"with {', '.join(differing)}; a submission has seeds of one setting"
            )


def read_run(folder: Path) -> SubmittedRun:
    """A seed's files, but for the weights, which are read when they are asked for.

    Raises:
        MarlMmError: If they are damaged.
    """
    config = read_config(folder)
    evaluation = read_evaluation(folder / EVALUATION)
    if evaluation is None:
        raise SubmissionError(f"{folder} has no {EVALUATION}")
    kept = read_json(folder / EPISODES, SubmissionError)
    check_kind(kept, dict[str, Any], str(folder / EPISODES), SubmissionError)
    for name, kind in _EPISODES.items():
        check_kind(
            kept.get(name), kind, f"{folder / EPISODES}: {name}", SubmissionError
        )
    parts = kept["sha256"], kept["first_action"]
    count = len(evaluation.rows)
    if {len(part) for part in parts} != {count} or count > MOST_GOALS:
        raise SubmissionError(
            f"{folder} has {count} rows, expected at most {MOST_GOALS:,}, and as many "
            f"values in {EPISODES}"
        )
    episodes = [Scored(*each) for each in zip(evaluation.rows, *parts, strict=True)]
    return SubmittedRun(folder, config, evaluation, episodes)
