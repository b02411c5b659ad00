"""Write a submission: evaluate runs once more, and keep all that scores them again."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from marl_mm.algorithms.checkpoint import read_checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import write_actors
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.datasets.dataset import load_dataset
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.goals import goal_set
from marl_mm.files import (
    new_folder,
    refuse_existing,
    refuse_foreign,
    refuse_input,
    write_json,
)
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.evaluate import task_overrides
from marl_mm.runs.folder import EVALUATION
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.run import Run, load_run
from marl_mm.runs.settings import as_path, check_positive, check_seed
from marl_mm.runs.submission import (
    EPISODES,
    FILES,
    FORMAT,
    MANIFEST,
    MEANS,
    MOST_GOALS,
    Scored,
    Submission,
    described,
    files_of,
    read_run,
    refuse_mixed,
    scored,
    seal,
)
from marl_mm.runs.submission_checks import (
    check_names,
    check_number,
    check_steps,
    read_submission,
)
from marl_mm.sim.config import ENGINES, Engine, to_record
from marl_mm.versions import machine, versions


def submit(
    runs: Sequence[Run | str | Path] | Run | str | Path,
    *,
    out: str | Path,
    episodes: int = 200,
    seed: int = 0,
    workers: int = 1,
    overwrite: bool = False,
    progress: Bar = silent_bar,
) -> Submission:
    """Evaluate finished runs of one setting, and write what scores them again.

    Their last checkpoints are evaluated anew, as an ``eval.json`` has no hashes of its
    episodes. The folder holds the actors' weights, no code and no dataset.

    Args:
        runs: Runs or their folders, one for each seed.
        out: Folder of the submission.
        episodes: Number of goals.
        seed: Seed of the goals.
        workers: Processes; the result does not depend on their number.
        overwrite: Replace an older submission.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Raises:
        UsageError: If runs are of several settings, or not trained to their end.
        CheckpointError: If a run is damaged.
    """
    check_positive(episodes=episodes, workers=workers)
    check_seed(seed)
    seed = int(seed)
    if episodes > MOST_GOALS:
        raise UsageError(f"`episodes` is {episodes}, expected at most {MOST_GOALS:,}")
    listed = [runs] if isinstance(runs, Run | str | Path) else runs
    if not isinstance(listed, Iterable):
        raise UsageError(f"{runs!r:.80} is no run, expected folders of marl-mm train")
    found = [run if isinstance(run, Run) else load_run(run) for run in listed]
    if not found:
        raise UsageError("no run given, expected folders of marl-mm train, one a seed")
    refuse_mixed([(str(run.folder), run.config) for run in found], UsageError)
    for run in found:
        _ = run.evaluated  # refuses one that is not trained to its end
    target = as_path(out, "out")
    holds = MANIFEST, *(f"[0-9]*/{name}" for name in FILES)
    refuse_foreign(target, overwrite, (MANIFEST, FORMAT), holds)
    refuse_input(target, [run.folder for run in found])
    if (target.absolute().parent / MANIFEST).exists():
        raise UsageError(f"{target} lies in another submission: choose another place")
    first = found[0].config
    engine = cast(Engine, first.engine)
    overrides = task_overrides(first.settings.get("max_steps"), engine)
    task = make_task(first.task, overrides)
    where = str(found[0].folder)
    check_number(where, len(found), UsageError)
    check_names(where, first, UsageError)
    check_steps(where, task, first.task, UsageError)
    packages = versions()
    version = packages[ENGINES[engine][0]]
    with new_folder(target) as new:
        with Rollouts(task, workers) as rollouts:
            for run in sorted(found, key=lambda run: run.config.seed):
                config = _shared(run.config)
                home = new / str(config.seed)
                home.mkdir()
                write_actors(home, read_checkpoint(run.folder), config.to_json())
                advance = progress(f"score seed {config.seed}", episodes)
                kept: list[Scored] = []
                plans = goal_set(task, episodes, seed)
                for episode in rollouts.run(load_policy(home), plans):
                    kept.append(scored(episode))
                    reached = sum(each.row["success"] for each in kept)
                    advance(1, f"{reached}/{len(kept)} reached")
                evaluation = Evaluation(
                    config.algorithm,
                    {},
                    config.task,
                    to_record(overrides),
                    seed,
                    [each.row for each in kept],
                    version,
                )
                _write_rows(home, evaluation, kept)
        seeds = sorted(run.config.seed for run in found)
        manifest = {
            "format": FORMAT,
            **described([read_run(new / str(number)) for number in seeds]),
            "task_config": config_dict(task),
            "packages": packages,
            "machine": machine(),
            "files": files_of(new, seeds),
        }
        write_json(new / MANIFEST, {**manifest, "fingerprint": seal(manifest)})
        read_submission(new)  # what a stranger would refuse is not written
        refuse_existing(target, overwrite)  # another process may have been faster
    return read_submission(target)


def _write_rows(home: Path, evaluation: Evaluation, kept: Sequence[Scored]) -> None:
    """Write the rows without means, which are the manifest's, and the hashes."""
    values = evaluation.to_json()
    for name in MEANS:
        del values[name]
    write_json(home / EVALUATION, values)
    hashes = {
        name: [getattr(each, name) for each in kept]
        for name in ("sha256", "first_action")
    }
    write_json(home / EPISODES, hashes)


def _shared(config: RunConfig) -> RunConfig:
    """A run's record without paths, and with what is known of its dataset."""
    settings: dict[str, Any] = dict(config.settings)
    if "start" in settings:
        settings["start"] = Path(settings["start"]).name
    if config.dataset is None:
        return replace(config, settings=settings)
    dataset = dict(config.dataset)
    path = dataset.pop("path", dataset["id"])
    with suppress(MarlMmError):  # it may be gone
        data = load_dataset(path)
        if data.fingerprint == dataset["fingerprint"]:
            dataset["data_sha256"] = data.metadata["marl_mm"]["data_sha256"]
            for name, recipe in RECIPES.items():
                if recipe.source.made(data.provenance):
                    dataset |= {"recipe": name, "recipe_sha256": recipe.fingerprint}
    return replace(config, settings=settings, dataset=dataset)
