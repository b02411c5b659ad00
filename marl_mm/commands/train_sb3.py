"""Stable-Baselines3 in a run folder like ours, for the tables (extra ``bench``)."""

from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from marl_mm.algorithms.online import is_flat
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import RunLog, is_best
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.eval.online import SB3
from marl_mm.files import only_here, write_json
from marl_mm.progress import progress_bar
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    EVALUATION,
    SB3_BEST,
    curve_point,
    refuse_other,
    start_run,
)
from marl_mm.runs.training import Online
from marl_mm.versions import versions


def check_sb3() -> None:
    """Raise before any work is done if Stable-Baselines3 is not installed.

    Raises:
        UsageError: Saying how to install it.
    """
    if find_spec("stable_baselines3") is None:
        raise UsageError("stable_baselines3 is missing: pip install 'marl-mm[bench]'")


def check_sb3_run(options: Online, seed: int, run: Path) -> None:
    """Raise if a finished run was made with something else.

    Raises:
        OtherConfigError: Naming what differs.
    """
    refuse_other(run, _run_config(options, seed))


def train_sb3_run(options: Online, seed: int, run: Path) -> None:
    """Train Stable-Baselines3's DDPG+HER and evaluate it as ours is.

    An interrupted run starts again: it keeps no checkpoints.
    """
    with only_here(run):
        _train(options, seed, run)


def _train(options: Online, seed: int, run: Path) -> None:
    from marl_mm.eval.bench.sb3_reference import Sb3Policy, learn_sb3, sb3_model

    config, schedule = options.config, options.schedule
    start_run(run, _run_config(options, seed))
    overrides = options.overrides
    model = sb3_model(options.task, config, seed, overrides)
    policy = Sb3Policy(model)
    best = run / SB3_BEST
    with (
        Rollouts(make_task(options.task, overrides), options.workers) as rollouts,
        RunLog(run, "episode", since=0) as log,
        progress_bar(f"{SB3} {seed}", config.episodes) as advance,
    ):

        def measure(episodes: int, goals: int) -> Evaluation:
            task = options.task
            return evaluate_with(rollouts, policy, episodes, goals, task, overrides)

        def look(episode: int, steps: int) -> bool:
            advance(1, "")
            if episode % (schedule.epoch * schedule.evaluate_every) == 0:
                goals = options.eval_seed + 1
                point = curve_point(measure(options.curve_episodes, goals))
                row = {"episode": episode, "env_steps": steps, **point}
                if is_best(row, log.rows):
                    model.save(best)
                log.add(row)
                advance(0, f"evaluated {100 * point['success/all']:.0f} %")
            flat = is_flat(log.rows, schedule.patience)
            return episode < config.episodes and not flat

        learn_sb3(model, look)
        last = measure(options.eval_episodes, options.eval_seed)
        if best.exists():
            model.set_parameters(str(best))
        chosen = measure(options.eval_episodes, options.eval_seed)
    write_json(run / EVALUATION, last.to_json())
    write_json(run / BEST_EVALUATION, chosen.to_json())


_UNUSED = (
    "action_penalty",
    "clip_targets",
    "critic_learning_rate",
    "demonstration_share",
    "demonstration_successes",
    "episodes_per_cycle",
    "layer_norm",
    "random_share",
    "std_floor",
)
"""Of our hyper-parameters: SB3 has no such thing."""


def _run_config(options: Online, seed: int) -> RunConfig:
    config = asdict(options.config)
    for name in _UNUSED:
        del config[name]
    return RunConfig(
        algorithm=SB3,
        seed=seed,
        task=options.task,
        packages=versions("stable-baselines3"),
        settings={
            **options.overrides,
            "curve_episodes": options.curve_episodes,
            "eval_seed": options.eval_seed,
            **asdict(options.schedule),
            **config,
        },
    )
