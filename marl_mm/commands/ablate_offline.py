"""Ablations of offline learning: what is missing is trained, and then drawn."""

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from marl_mm.commands.ablate_check import check_tables, every_failure
from marl_mm.commands.ablate_draw import draw, drawings
from marl_mm.commands.ablate_jobs import Complaint, Job, do_jobs
from marl_mm.commands.ablate_options import AblateOffline
from marl_mm.commands.ablate_plan import (
    Wanted,
    estimated,
    hours,
    missing_cells,
    plan_table,
)
from marl_mm.errors import FailedRunsError, UsageError
from marl_mm.eval.ablation import Ablation, cell_name
from marl_mm.eval.metrics import Row
from marl_mm.files import refuse_existing


def ablate_offline(
    options: AblateOffline,
    ablations: Mapping[str, Ablation],
    show: Callable[[str, list[Row], str], None],
) -> None:
    """Make what is missing of some ablations, and draw them.

    Args:
        options: What was asked for.
        ablations: By name.
        show: Called with name, rows and text of every table that is drawn.

    Raises:
        UsageError: If a dataset or a setting is not the ablation's, or not there.
        OtherConfigError: If a run was made with something else.
        FailedRunsError: At the end; what could be drawn has been.
        MarlMmError: With ``--check``, if files are not what is drawn.
    """
    chosen = {name: _chosen(one, options) for name, one in ablations.items()}
    whole = [n for n in chosen if len(chosen[n].cells) == len(ablations[n].cells)]
    stems = {name: name if name in whole else f"{name}-part" for name in chosen}
    if options.check:
        _check(options, chosen, whole)
        return
    if not options.plan:
        for name, ablation in chosen.items():
            for file in drawings(stems[name], ablation):
                again = options.overwrite or options.resume
                refuse_existing(options.results() / file, again)
    wanted = missing_cells(options, chosen.values())
    full = options.budget == "full"
    left = sum(not job.done for one in wanted for job in one.jobs)
    if full and left:
        wanted = estimated(wanted)
    if options.plan:
        print(plan_table(wanted, options.workers, full), end="")
        return
    failed = _make_rows(options, wanted)
    incomplete = {one.name for one in wanted if failed.keys() & one.runs}
    drawn = []
    for name, one in chosen.items():
        if incomplete.isdisjoint(map(cell_name, one.cells)):
            show(name, *_draw(options, stems[name], one))
            drawn.append(name)
    if failed:
        reasons = "; ".join(f"{run}: {why}" for run, why in failed.items())
        raise FailedRunsError(
            f"{len(failed)} of {left} runs failed, the same command with --resume "
            f"tries them again; drawn: {', '.join(drawn) or 'nothing'}; {reasons}"
        )


def _check(
    options: AblateOffline, chosen: Mapping[str, Ablation], whole: Collection[str]
) -> None:
    """Whether what was drawn is what its rows give."""
    if len(whole) < len(chosen):
        raise UsageError("--check is for whole tables, without --datasets, --settings")
    with every_failure() as attempt:
        for name, ablation in chosen.items():
            again = partial(_draw, options, name, ablation)
            attempt(partial(check_tables, options.results(), [f"{name}.csv"], again))


def _draw(
    options: AblateOffline, stem: str, ablation: Ablation, folder: Path | None = None
) -> tuple[list[Row], str]:
    """Draw an ablation into a folder, or where its rows are."""
    seeds, folder = options.seeds_of(ablation), folder or options.results()
    return draw(stem, ablation, options.store(), seeds, folder)


def _make_rows(
    options: AblateOffline, wanted: Sequence[Wanted]
) -> dict[Path, Complaint]:
    """Do the jobs, and keep the rows of each cell as soon as all its runs are done.

    Returns:
        Runs that failed, and why.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    store = options.store()
    cell_of = {job.run: one for one in wanted for job in one.jobs}

    def keep_if_done(one: Wanted) -> None:
        if all(job.done for job in one.jobs):
            store.keep(one.cell, {job.seed: job.run for job in one.jobs}, one.probes)

    def done(job: Job) -> None:
        keep_if_done(cell_of[job.run])

    for one in wanted:
        keep_if_done(one)
    jobs = [job for one in wanted for job in one.jobs]
    left = [job for job in jobs if not job.done]
    if not left:
        return {}
    told = f"{len(left)} of {len(jobs)} runs are missing in {options.runs_folder()}"
    if options.budget == "full":
        told += f", about {hours(left, options.workers):.1f} hours"
    print(f"{told}; after Ctrl-C, go on with --resume", file=sys.stderr)
    try:
        return do_jobs(left, options.workers, options.executor, done)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped in {options.runs_folder()}: go on with --resume"
        ) from None


def _chosen(ablation: Ablation, options: AblateOffline) -> Ablation:
    """The part of an ablation that was asked for."""
    known = [(dataset, setting.name) for dataset, setting in ablation.cells]
    datasets = _named("datasets", options.datasets, [name for name, _ in known])
    settings = _named("settings", options.settings, [name for _, name in known])
    cells = tuple(
        (dataset, setting)
        for dataset, setting in ablation.cells
        if dataset in datasets and setting.name in settings
    )
    if not cells:
        raise UsageError(
            f"--settings {' '.join(settings)} are not run on --datasets "
            f"{' '.join(datasets)}: leave out one of both"
        )
    return replace(ablation, cells=cells)


def _named(
    option: str, asked: tuple[str, ...] | None, known: Sequence[str]
) -> Sequence[str]:
    choices = list(dict.fromkeys(known))
    unknown = [one for one in asked or () if one not in choices]
    if unknown or asked == ():
        missing = f"has no {unknown[0]!r}" if unknown else "is empty"
        raise UsageError(f"--{option} {missing}: expected {', '.join(choices)}")
    return choices if asked is None else asked
