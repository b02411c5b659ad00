"""Stable-Baselines3 in a run folder like ours, for the tables (extra ``bench``)."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from marl_mm.algorithms.online import is_flat
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import RunLog, is_best
from marl_mm.declared import as_record
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import UsageError
from marl_mm.eval.bench import SB3
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.files import only_here, write_json
from marl_mm.progress import Bar
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    EVALUATION,
    SB3_BEST,
    refuse_other,
    start_run,
)
from marl_mm.runs.learning import curve_point
from marl_mm.runs.training import Online
from marl_mm.sim.config import default_engine
from marl_mm.versions import versions


def check_sb3_run(training: Online, seed: int, run: Path) -> None:
    """Raise before any work is done for what would stop a run.

    Raises:
        UsageError: If Stable-Baselines3 is not installed, or is to replay a dataset.
        OtherConfigError: If a finished run was made with something else.
    """
    if training.demonstrations is not None:
        raise UsageError(f"{SB3} replays no demonstrations: leave them out")
    if (run / EVALUATION).exists():
        refuse_other(run, _run_config(training, seed), training.config)
    elif find_spec("stable_baselines3") is None:
        raise UsageError("stable_baselines3 is missing: pip install -e '.[bench]'")


def made_of(training: Online) -> dict[str, Any]:
    """Config that rows must have been made with, without the seed."""
    return {"algorithm": SB3, "task": training.task, **_settings(training)}


def train_sb3_run(training: Online, seed: int, run: Path, bar: Bar) -> None:
    """Train Stable-Baselines3's DDPG+HER and evaluate it as ours is.

    An interrupted run starts again: it keeps no checkpoints.
    """
    with only_here(run, wait=True):
        _train(training, seed, run, bar)


def _train(training: Online, seed: int, run: Path, bar: Bar) -> None:
    from marl_mm.eval.bench.sb3_reference import Sb3Policy, learn_sb3, sb3_model

    config, schedule = training.config, training.schedule
    start_run(run, _run_config(training, seed))
    overrides = training.overrides
    model = sb3_model(training.task, config, seed, overrides)
    policy = Sb3Policy(model)
    best = run / SB3_BEST
    with (
        Rollouts(make_task(training.task, overrides), training.workers) as rollouts,
        RunLog(run, "episode", since=0) as log,
    ):
        advance = bar(f"{SB3} {seed}", config.episodes)

        def measure(episodes: int, goals: int) -> Evaluation:
            task = training.task
            return evaluate_with(rollouts, policy, episodes, goals, task, overrides)

        def look(episode: int, steps: int) -> bool:
            advance(1, "")
            if episode % (schedule.epoch * schedule.evaluate_every) == 0:
                goals = training.eval_seed + 1
                point = curve_point(measure(training.curve_episodes, goals))
                row = {"episode": episode, "env_steps": steps, **point}
                if is_best(row, log.rows):
                    model.save(best)
                log.add(row)
                advance(0, f"evaluated {100 * point['success/all']:.0f} %")
            flat = is_flat(log.rows, schedule.patience)
            return episode < config.episodes and not flat

        learn_sb3(model, look)
        last = measure(training.eval_episodes, training.eval_seed)
        if best.exists():
            model.set_parameters(str(best))
        chosen = measure(training.eval_episodes, training.eval_seed)
    write_json(run / EVALUATION, last.to_json())
    write_json(run / BEST_EVALUATION, chosen.to_json())


_UNUSED = (
    "action_penalty",
    "clip_targets",
    "critic_learning_rate",
    "demonstration_share",
    "demonstration_successes",
    "episodes_per_cycle",
    "eval_episodes",
    "layer_norm",
    "random_share",
    "std_floor",
)
"""Hyper-parameters of ours that Stable-Baselines3 does not have, and what its records
never had."""


def _settings(training: Online) -> dict[str, Any]:
    settings = training.recorded | as_record(training.config)
    return {name: settings[name] for name in settings if name not in _UNUSED}


def _run_config(training: Online, seed: int) -> RunConfig:
    return RunConfig(
        algorithm=SB3,
        seed=seed,
        task=training.task,
        engine=training.engine or default_engine(),
        packages=versions("stable-baselines3"),
        settings=_settings(training),
    )
