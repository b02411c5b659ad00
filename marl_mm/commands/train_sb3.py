"""Stable-Baselines3 in a run folder like ours, for the tables (extra ``bench``)."""

from dataclasses import asdict
from pathlib import Path

from marl_mm.algorithms.online import is_flat
from marl_mm.algorithms.runlog import RunLog
from marl_mm.commands.runs import (
    BEST_EVALUATION,
    EVALUATION,
    curve_point,
    start_run,
)
from marl_mm.commands.train_online import TrainDdpg
from marl_mm.envs.config import reach_config
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.files import write_json
from marl_mm.progress import progress_bar
from marl_mm.versions import versions


def train_sb3_run(options: TrainDdpg, seed: int, run: Path) -> None:
    """Train Stable-Baselines3's DDPG+HER and evaluate it as ours is.

    It knows no ``--resume``: an interrupted run starts again. The best policy is that
    of the evaluation with the best success rate, the first one of equals.

    Raises:
        UsageError: If Stable-Baselines3 is not installed.
    """
    try:
        from marl_mm.eval.sb3_reference import NAME, Sb3Policy, learn_sb3, sb3_model
    except ImportError as error:
        raise UsageError(
            f"{error.name} is missing: pip install 'marl-mm[bench]'"
        ) from error
    config, schedule = options.config, options.schedule
    values = {
        "algorithm": NAME,
        "seed": seed,
        "task": options.task,
        "curve_episodes": options.curve_episodes,
        "eval_seed": options.eval_seed,
        "packages": versions(),
        **asdict(schedule),
        **asdict(config),
    }
    start_run(run, values)
    model = sb3_model(options.task, config, seed)
    policy = Sb3Policy(model)
    best, best_success = run / "best.zip", -1.0
    with (
        Rollouts(reach_config(options.task), 1) as rollouts,
        RunLog(run, "episode", since=0) as log,
        progress_bar(f"{NAME} {seed}", config.episodes) as advance,
    ):

        def measure(episodes: int, goals: int) -> Evaluation:
            return evaluate_with(rollouts, policy, episodes, goals, options.task)

        def look(episode: int, steps: int) -> bool:
            nonlocal best_success
            row = {"episode": episode, "env_steps": steps}
            point = curve_point(measure(options.curve_episodes, options.eval_seed + 1))
            log.add(row | point)
            if point["success/all"] > best_success:
                best_success = point["success/all"]
                model.save(best)
            advance(schedule.epoch, f"evaluated {100 * point['success/all']:.0f} %")
            return episode < config.episodes and not is_flat(
                log.rows, schedule.patience
            )

        learn_sb3(model, schedule.epoch, look)
        last = measure(options.eval_episodes, options.eval_seed)
        write_json(run / EVALUATION, last.to_json())
        model.set_parameters(str(best))
        chosen = measure(options.eval_episodes, options.eval_seed)
        write_json(run / BEST_EVALUATION, chosen.to_json())
