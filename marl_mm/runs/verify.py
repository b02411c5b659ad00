"""Score a submission again, and compare: episode by episode, then by intervals."""

import time
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from marl_mm.declared import plain
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import SubmissionError, UsageError
from marl_mm.files import refuse_existing, write_json
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.comparison import Pairs, differing, notes, other_recipe
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.runs.submission import Submission, scored
from marl_mm.runs.submission_checks import read_submission
from marl_mm.runs.verification import (
    Verdict,
    Verification,
    read_verification,
    stands,
    verification_file,
)
from marl_mm.versions import machine, versions

_BLOCK = 10
"""Goals of each seed that are scored between two looks at the clock."""


def verify(
    folder: str | Path | Submission,
    *,
    minutes: float = 10.0,
    seed: int | None = None,
    workers: int = 1,
    progress: Bar = silent_bar,
) -> Verification:
    """Score a submission again, and keep the verdict in a file beside its folder.

    Goals are taken in random order until all are done, or time is up. An earlier record
    that says "not equal", or scored more episodes, is kept unless this verdict is "not
    equal" or of all episodes. Notes of what is returned say where it was kept.

    Args:
        folder: Folder of the submission, or what ``submit`` returned.
        minutes: Time after which no more goals are begun [min].
        seed: Seed of the order; default drawn, so that nobody knows it before.
        workers: Processes; the result does not depend on their number.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Raises:
        UsageError: If there is no submission, or a setting makes no sense.
        SubmissionError: If its files or rows have been changed.
        CheckpointError: If its weights are damaged.
    """
    check_positive(workers=workers)
    minutes = plain(minutes)
    number = isinstance(minutes, int | float) and not isinstance(minutes, bool)
    if not (number and minutes > 0):
        raise UsageError(f"`minutes` is {minutes!r:.40}, expected > 0")
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    check_seed(seed)
    seed = int(seed)
    begun = time.monotonic()
    named = folder.folder if isinstance(folder, Submission) else folder
    submission = read_submission(named)  # as its files are now
    file = verification_file(submission.folder)
    refuse_existing(file, overwrite=True, file=True)
    pairs = _scored_again(submission, begun + 60 * minutes, seed, workers, progress)
    every = [pair for each in pairs for pair in each]
    claimed, again = (
        float(np.mean([episode.row["success"] for episode in episodes]))
        for episodes in zip(*every, strict=True)
    )
    equal = [c.sha256 == a.sha256 for c, a in every]
    differences = (*other_recipe(submission), *differing(submission, pairs))
    verdict: Verdict = "equal to the bit" if all(equal) else "equal within intervals"
    result = Verification(
        fingerprint=submission.fingerprint,
        verdict="not equal" if differences else verdict,
        differences=differences,
        notes=tuple(notes(submission, equal, every)),
        scored=len(equal),
        episodes=submission.scores("success").size,
        equal=sum(equal),
        claimed=claimed,
        success=again,
        seed=seed,
        seconds=time.monotonic() - begun,
        packages=versions(),
        machine=machine(),
    )
    earlier = None
    with suppress(SubmissionError):  # a damaged one is replaced
        earlier = read_verification(submission)  # as it is by now
    if earlier is not None and stands(earlier, result):
        kept = f"{earlier['verdict']}, {earlier['scored']} scored before"
        return replace(result, notes=(*result.notes, f"kept on record: {kept}"))
    write_json(file, asdict(result))
    return result


def _scored_again(
    submission: Submission, end: float, seed: int, workers: int, progress: Bar
) -> list[Pairs]:
    """Episodes of each seed on the same goals, as many as there is time for."""
    plans, runs = submission.plans, submission.runs
    order = np.random.default_rng(seed).permutation(len(plans)).tolist()
    advance = progress("score again", len(plans) * len(runs))
    pairs: list[Pairs] = [[] for _ in runs]
    of_a_goal, equal = 0.0, 0  # [s]
    # The second goal tells the time: the first one compiles.
    starts = [0, 1, *range(2, len(order), _BLOCK)]
    with Rollouts(submission.task, workers) as rollouts:
        for start, stop in zip(starts, [*starts[1:], len(order)], strict=True):
            block, begun = order[start:stop], time.monotonic()
            if start and begun + of_a_goal * len(block) > end:
                break
            for run, own in zip(runs, pairs, strict=True):
                again = rollouts.run(run.policy, [plans[i] for i in block])
                for index, episode in zip(block, again, strict=True):
                    own.append((run.episodes[index], scored(episode)))
                    equal += own[-1][0].sha256 == own[-1][1].sha256
                    advance(1, f"{equal}/{sum(map(len, pairs))} equal to the bit")
            of_a_goal = (time.monotonic() - begun) / max(len(block), 1)
    return pairs
