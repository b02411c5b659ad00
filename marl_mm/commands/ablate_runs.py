"""The runs that figures and tables are made of: what is missing of them is trained."""

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.schedule import Schedule
from marl_mm.collectors.pd import PdConfig
from marl_mm.commands.options import COMMITTED
from marl_mm.commands.train_sb3 import check_sb3, check_sb3_run, train_sb3_run
from marl_mm.datasets.location import locate
from marl_mm.envs.registry import make_task
from marl_mm.envs.task import ScriptConfig
from marl_mm.errors import (
    DivergedError,
    FailedRunsError,
    MarlMmError,
    OtherConfigError,
)
from marl_mm.eval.online import SETTINGS, OnlineSetting
from marl_mm.files import only_here
from marl_mm.progress import Bar, progress_bars
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.runs.folder import BEST_EVALUATION, EVALUATION
from marl_mm.runs.online import (
    check_online_run,
    evaluate_online_run,
    train_online_run,
)
from marl_mm.runs.training import Online, online_training
from marl_mm.workers import available_cores

ANOTHER_FOLDER = "name another folder with --runs, or delete this one"
"""What to do about a run that was made with something else."""

DEMONSTRATIONS = "demonstrations"
"""Dataset of an agent that knows how, in the folder of the runs."""


@dataclass(frozen=True)
class Ablate:
    """What every target needs."""

    runs: Path | None = None
    """Folder of the raw runs, RUNS/SETTING/SEED; missing ones are trained; default
    runs/online, or runs/online-smoke."""

    out: Path | None = None
    """Folder of figures and tables; default RUNS/results, with --check in a clone
    eval/results/online."""

    seeds: tuple[int, ...] = (0, 1, 2)
    """One run each of every setting: the seeds, not their number."""

    settings: tuple[str, ...] | None = None
    """For "runs" and "online": those named, which "runs --help" lists; default all. Of
    some settings, the table's files are called online-part."""

    rows: Path | None = None
    """Draw from the rows in this folder, such as curves.csv.gz, and not from runs."""

    check: bool = False
    """Only say whether tables in OUT are what its rows give, to the byte."""

    budget: Literal["full", "smoke"] = "full"
    """"smoke": hardly any training, to see that everything works."""

    workers: int = field(default_factory=available_cores)
    """Processes that run episodes; the result does not depend on it."""

    plan: bool = False
    """Only print how many runs are missing, and about how long they will take."""

    resume: bool = False
    """Go on after an interruption, and replace what was drawn until then; runs go on
    from their last checkpoints anyway."""

    overwrite: bool = False
    """Replace figures and tables that exist; runs are never replaced."""

    json: bool = False
    """Print the table as JSON ("online" and "alpha")."""

    quiet: Annotated[bool, tyro.conf.Suppress] = False
    """Print nothing."""

    def runs_folder(self) -> Path:
        """``runs`` or its default."""
        name = "online-smoke" if self.budget == "smoke" else "online"
        return self.runs or Path("runs") / name

    def results_folder(self) -> Path:
        """``out`` or its default."""
        elsewhere = self.out or self.runs or self.budget == "smoke"
        if self.check and not elsewhere and COMMITTED.exists():
            return COMMITTED / "online"
        return self.out or self.runs_folder() / "results"

    def results(self, name: str) -> Path:
        """Where a figure or table goes."""
        return self.results_folder() / name


def train_missing(options: Ablate, names: Sequence[str]) -> None:
    """Train what is missing of these settings.

    Raises:
        UsageError: If Stable-Baselines3 is needed and not installed.
        OtherConfigError: If a run was made with something else.
        FailedRunsError: At the end, if some failed; the others are there.
    """
    wanted = [setting for setting in SETTINGS if setting.name in names]
    shown = dict.fromkeys(one.task for one in wanted if one.demonstrations)
    demonstrations = {task: _demonstrations(options, task) for task in shown}
    cells = [(setting, seed) for setting in wanted for seed in options.seeds]
    if any(s.library == "sb3" and not _finished(options, s, n) for s, n in cells):
        check_sb3()
    missing = [cell for cell in cells if not _finished(options, *cell)]
    announce(options.runs_folder(), len(missing), len(cells))
    as_it_was_to_be = partial(check_online_run, further=False)
    failed: dict[Path, str] = {}
    for setting, seed in cells:
        run = _run(options, setting, seed)
        finished = _finished(options, setting, seed)
        data = demonstrations[setting.task] if setting.demonstrations else None
        training = _training(options, setting, data, finished, run)
        sb3 = setting.library == "sb3"
        if finished or training.resume:
            try:
                check = check_sb3_run if sb3 else as_it_was_to_be
                check(training, seed, run)
            except OtherConfigError as error:
                raise OtherConfigError(error.difference, ANOTHER_FOLDER) from error
        if finished:
            continue
        try:
            if sb3:
                train_sb3_run(training, seed, run)
                continue
            with progress_bars() as bar:
                _train_or_keep(training, seed, run, bar)
        except KeyboardInterrupt:
            again = "starts it again" if sb3 else "goes on from there"
            raise KeyboardInterrupt(
                f"stopped in {run}; the same command {again}"
            ) from None
        except MarlMmError as error:
            failed[run] = str(error)
            print(f"{run} failed: {error}; going on with others", file=sys.stderr)
    if failed:
        reasons = "; ".join(f"{run}: {why}" for run, why in failed.items())
        raise FailedRunsError(
            f"{len(failed)} of {len(missing)} runs failed, the same command tries them "
            f"again: {reasons}"
        )


def check_installed(options: Ablate, names: Collection[str]) -> None:
    """Raise, before a night of other runs, if one needs what is not installed.

    Raises:
        UsageError: Naming it.
    """
    wanted = [setting for setting in SETTINGS if setting.name in names]
    sb3 = [setting for setting in wanted if setting.library == "sb3"]
    if not all(_finished(options, s, n) for s in sb3 for n in options.seeds):
        check_sb3()


def told_missing(options: Ablate, names: Collection[str]) -> str:
    """How many runs of these settings are missing, in words."""
    wanted = [setting for setting in SETTINGS if setting.name in names]
    cells = [(setting, seed) for setting in wanted for seed in options.seeds]
    trains = options.rows is None
    missing = sum(trains and not _finished(options, *cell) for cell in cells)
    told = f"{missing} of {len(cells)} online runs"
    if options.budget == "smoke":
        return told
    return f"{told}, about {missing / 6:.1f} hours at ten minutes each"


def announce(folder: Path, missing: int, wanted: int) -> None:
    """Say how much is to be trained, which may take a night."""
    if missing:
        print(
            f"{missing} of {wanted} runs are missing in {folder}, trained now; after "
            "Ctrl-C the same command goes on",
            file=sys.stderr,
        )


def _run(options: Ablate, setting: OnlineSetting, seed: int) -> Path:
    return options.runs_folder() / setting.name / str(seed)


def _finished(options: Ablate, setting: OnlineSetting, seed: int) -> bool:
    run = _run(options, setting, seed)
    return all((run / name).exists() for name in (EVALUATION, BEST_EVALUATION))


def _train_or_keep(training: Online, seed: int, run: Path, bar: Bar) -> None:
    """Train, and if that diverges, go by what there was before: it is a result, too."""
    try:
        train_online_run(training, seed, run, bar)
    except DivergedError as error:
        if not (run / BEST).exists():
            raise
        print(f"{error}; it counts as it is", file=sys.stderr)
        evaluate_online_run(training, run, bar)


def _training(
    options: Ablate,
    setting: OnlineSetting,
    demonstrations: Path | None,
    finished: bool,
    run: Path,
) -> Online:
    """Options of one setting's runs."""
    small = options.budget == "smoke"
    going = finished or (run / FILE).exists()
    training = online_training(
        setting.algorithm,
        setting.preset,
        task=setting.task,
        demonstrations=None if demonstrations is None else str(demonstrations),
        eval_episodes=2 if small else 200,
        curve_episodes=2 if small else 50,
        max_steps=4 if small else None,
        workers=options.workers,
        resume=going,
        overwrite=not going,  # of a folder without a checkpoint
        schedule=Schedule(epoch=4) if small else Schedule(),
    )
    changes = dict(setting.changes)
    if small:
        changes |= {"episodes": 8, "warm_up": 12, "updates_per_episode": 5}
    return replace(training, config=replace(training.config, **changes))


def _demonstrations(options: Ablate, task: str) -> Path:
    """A dataset of PD, with a rule for alpha, or of the script; collected once."""
    takes = "grip" in make_task(task).layout.action_names
    collector = "scripted" if takes else "pd"
    policy = ScriptConfig() if takes else PdConfig(alpha_rule="room")
    name = DEMONSTRATIONS if task == "Reach-v0" else f"{DEMONSTRATIONS}-{task}"
    path = (options.runs_folder() / name).resolve()
    steps = 100 if options.budget == "smoke" else 2_000
    with only_here(path.parent, wait=True):  # others may need it as well
        location = locate(str(path))
        with progress_bars() as bar:
            collection = collect_dataset(
                location,
                collector,
                policy,
                Collecting(
                    steps=steps,
                    task=task,
                    workers=options.workers,
                    resume=location.folder.exists() or location.working.exists(),
                ),
                bar=bar,
            )
        if not collection.complete:
            raise KeyboardInterrupt("stopped; the same command goes on there")
    return path
