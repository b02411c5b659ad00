"""Score a submission again, and compare: episode by episode, then by intervals."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import stdtrit
from scipy.stats import binom

from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import SubmissionError, UsageError
from marl_mm.eval.intervals import mean_interval
from marl_mm.eval.metrics import METRICS
from marl_mm.files import refuse_existing, write_json
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import check_kind, read_json
from marl_mm.registry import BUILT_IN
from marl_mm.runs.recipes import RECIPES, recorded
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.runs.submission import Scored, Submission, scored
from marl_mm.runs.submission_checks import read_submission
from marl_mm.versions import machine, versions

Verdict = Literal["equal to the bit", "equal within intervals", "not equal"]

_BLOCK = 10
"""Goals of each seed that are scored between two looks at the clock."""

_CONFIDENCE = 0.99
"""Confidence of the intervals of differences."""

_MARGINS = {"success": 0.0005, "return": 0.005}
"""Largest differences of means that no table shows, by name."""

_FLIPPED = 0.023
"""Probability that a goal has another outcome on another processor: two engines differ
on 0.1 to 2.3 % of goals, mean over policies."""

_FIRST_ACTION = 1e-4
"""Largest difference of the same weights' first action between processors."""

_REPEATED = 0.1
"""Share of equal episodes, of all seeds, from which a machine is the submission's, and
all have to be equal: another processor changes last bits in every episode."""

_TWINS = 0.5
"""Share of goals with the same first action from which two seeds are no two runs."""

_LISTED = 5
"""Largest number of goals that a message lists."""


@dataclass(frozen=True)
class Verification:
    """Result of scoring a submission again."""

    fingerprint: str
    """Fingerprint of the submission."""

    verdict: Verdict
    """Whether it is what was submitted."""

    differences: tuple[str, ...]
    """What differs, in words; empty if it is equal."""

    notes: tuple[str, ...]
    """What a reader should know of the comparison, in words."""

    scored: int
    """Number of episodes that were run again."""

    episodes: int
    """Number of episodes of the submission."""

    equal: int
    """Number of episodes of which all bits are equal."""

    claimed: float
    """Success rate that is claimed of the episodes that were run again."""

    success: float
    """Success rate of these episodes, run again."""

    seed: int
    """Seed of the order in which goals were chosen."""

    seconds: float
    """Time that it took [s]."""

    packages: dict[str, str]
    """Versions of the packages here, by name."""

    machine: dict[str, str]
    """Processor and system here."""

    def in_words(self) -> str:
        """The verdict in a line."""
        return (
            f"{self.verdict}: {self.equal} of {self.scored} episodes have the same bits"
            f" ({self.episodes} were submitted), success {100 * self.success:.1f} % "
            f"(claimed {100 * self.claimed:.1f} %), {self.seconds:.0f} s"
        )


VERIFIED = ".verified.json"
"""End of a verification's file, after the name of the submission's folder."""


def verification_file(folder: str | Path) -> Path:
    """File of a submission's verification: beside its folder, which stays as it is."""
    path = Path(folder).resolve()
    return path.with_name(f"{path.name}{VERIFIED}")


def read_verification(submission: Submission) -> dict[str, Any] | None:
    """The record of a submission's verification; None where there is none of it.

    Raises:
        SubmissionError: If it is damaged.
    """
    path = verification_file(submission.folder)
    if not path.exists():
        return None
    values: dict[str, Any] = read_json(path, SubmissionError)
    check_kind(values, dict[str, Any], str(path), SubmissionError)
    kinds: dict[str, Any] = {"fingerprint": str, "verdict": str, "success": float}
    for name, kind in (kinds | {"scored": int, "episodes": int}).items():
        check_kind(values.get(name), kind, f"{path}: {name}", SubmissionError)
    return values if values["fingerprint"] == submission.fingerprint else None


def verify(
    folder: str | Path | Submission,
    *,
    minutes: float = 10.0,
    seed: int | None = None,
    workers: int = 1,
    progress: Bar = silent_bar,
) -> Verification:
    """Score a submission again, and keep the verdict in a file beside its folder.

    Goals are taken in random order until all are done, or time is up. An earlier
    verdict "not equal", or of more episodes, is replaced by one of all episodes only,
    or by "not equal".

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
    if not isinstance(minutes, int | float) or not minutes > 0:
        raise UsageError(f"`minutes` is {minutes!r:.40}, expected > 0")
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    check_seed(seed)
    begun = time.monotonic()
    submission = folder if isinstance(folder, Submission) else read_submission(folder)
    file = verification_file(submission.folder)
    refuse_existing(file, overwrite=True)
    earlier = None
    with suppress(SubmissionError):  # a damaged one is replaced
        earlier = read_verification(submission)
    pairs = _scored_again(submission, begun + 60 * minutes, seed, workers, progress)
    every = [pair for each in pairs for pair in each]
    claimed, again = (
        float(np.mean([episode.row["success"] for episode in episodes]))
        for episodes in zip(*every, strict=True)
    )
    equal = [c.sha256 == a.sha256 for c, a in every]
    differences = (*_recipe(submission), *_differing(submission, pairs))
    within: Verdict = "equal to the bit" if all(equal) else "equal within intervals"
    result = Verification(
        submission.fingerprint,
        "not equal" if differences else within,
        differences,
        tuple(_notes(submission, equal, every)),
        len(equal),
        submission.scores("success").size,
        sum(equal),
        claimed,
        again,
        seed,
        time.monotonic() - begun,
        versions(),
        machine(),
    )
    if earlier is not None and _stands(earlier, result):
        kept = f"{earlier['verdict']}, {earlier['scored']} scored before"
        return replace(result, notes=(*result.notes, f"kept on record: {kept}"))
    write_json(file, asdict(result))
    return result


def _stands(earlier: Mapping[str, Any], result: Verification) -> bool:
    """Whether an earlier verification knows more.

    It has found what is false, or has scored more episodes.
    """
    if result.verdict == "not equal" or result.scored == result.episodes:
        return False
    more: bool = earlier["scored"] > result.scored
    return more or earlier["verdict"] == "not equal"


Pairs = list[tuple[Scored, Scored]]
"""Episodes of a seed: as claimed, and run again."""


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


def _differing(submission: Submission, pairs: Sequence[Pairs]) -> Iterator[str]:
    """What differs beyond the last bits of another processor, in words."""
    rest: Pairs = []
    every = [claimed.sha256 == again.sha256 for own in pairs for claimed, again in own]
    repeats = (equal := sum(every)) >= _REPEATED * len(every)
    for run, own in zip(submission.runs, pairs, strict=True):
        name = f"seed {run.config.seed}"
        same = [(c, a) for c, a in own if c.sha256 == a.sha256]
        other = [(c, a) for c, a in own if c.sha256 != a.sha256]
        if false := [(c, a) for c, a in same if _forged(c, a)]:
            odd = sorted({key for pair in false for key in _forged(*pair)})
            yield (
                f"{name}: rows of goals {_goals(false)} do not follow from their "
                f"episodes, by {', '.join(odd)}"
            )
        if strange := [(c, a) for c, a in other if not _alike(c, a)]:
            yield (
                f"{name}: first actions of goals {_goals(strange)}, or goals, are "
                "others: these weights did not make these rows"
            )
        elif other and repeats:
            yield (
                f"{name}: episodes of goals {_goals(other)} are others, while {equal} "
                f"of all {len(every)} are equal to the bit on this machine"
            )
            continue
        rest += other
    yield from _apart(rest)


def _goals(pairs: Pairs) -> str:
    indices = sorted(claimed.row["index"] for claimed, _ in pairs)
    more = len(indices) - _LISTED
    listed = ", ".join(map(str, indices[:_LISTED]))
    return f"{listed} and {more} more" if more > 0 else listed


def _forged(claimed: Scored, again: Scored) -> set[str]:
    """Keys by which a row is not that of the same episode; plug-ins add others."""
    there, here = dict(claimed.row), dict(again.row)
    both = {k: (there[k], here[k]) for k in there.keys() & here.keys()}
    odd = {k for k, (c, a) in both.items() if c != a and (c == c or a == a)}  # no NaN
    odd |= {
        name
        for name in here.keys() - there.keys()
        if name not in METRICS or METRICS.origin(name) == BUILT_IN
    }
    return odd if claimed.first_action == again.first_action else {*odd, "first action"}


def _alike(claimed: Scored, again: Scored) -> bool:
    """Whether goal and first action are the same but for a processor's last bits."""
    pairs = (
        (claimed.row["goal"], again.row["goal"]),
        (claimed.first_action, again.first_action),
    )
    return all(
        len(old) == len(new) and np.allclose(old, new, rtol=0, atol=_FIRST_ACTION)
        for old, new in pairs
    )


def _apart(pairs: Pairs) -> Iterator[str]:
    """Outcomes of too many goals, and means that differ beyond chance, in words."""
    flipped = [(c, a) for c, a in pairs if c.row["success"] != a.row["success"]]
    if len(flipped) > binom.isf(1 - _CONFIDENCE, len(pairs), _FLIPPED):
        yield (
            f"success: {len(flipped)} of {len(pairs)} goals have another outcome than "
            "is claimed, more than another processor explains"
        )
    for name, margin in _MARGINS.items():
        rows = [(float(c.row[name]), float(a.row[name])) for c, a in pairs]  # type: ignore[literal-required]
        raised = np.array([claimed - again for claimed, again in rows])
        if len(raised) == 0 or abs(mean := float(raised.mean())) <= margin:
            continue
        low, high = mean, mean
        if len(raised) > 1:
            low, high = mean_interval(raised, _CONFIDENCE)
        if len(raised) > 1 and name == "return":
            # No wider than for other goals: one row could widen it to any width.
            spread = np.sqrt(2 / len(rows)) * np.std(np.array(rows)[:, 1], ddof=1)
            most = stdtrit(len(rows) - 1, (1 + _CONFIDENCE) / 2) * float(spread)
            low, high = max(low, mean - most), min(high, mean + most)
        if not low <= 0 <= high:
            claimed, again = np.mean(rows, axis=0)
            yield (
                f"{name}: claimed {claimed:.3f}, scored again {again:.3f} on the same "
                f"{len(rows)} goals; difference [{low:.3f}, {high:.3f}]"
            )


def _recipe(submission: Submission) -> Iterator[str]:
    """Whether the dataset's recipe is another one here."""
    dataset = submission.manifest["dataset"] or {}
    name = dataset.get("recipe", "")
    claimed = dataset.get("recipe_sha256")
    if name in RECIPES and RECIPES.get(name).fingerprint != claimed:
        yield f"dataset: the recipe {name} is another one here"


def _twins(submission: Submission) -> Iterator[str]:
    """Seeds that hardly differ, in words."""
    begun = [[each.first_action for each in run.episodes] for run in submission.runs]
    if len({len(action) for actions in begun for action in actions}) > 1:
        return  # made by no policy
    for (i, one), (j, other) in combinations(enumerate(map(np.array, begun)), 2):
        alike = int((np.abs(one - other) <= _FIRST_ACTION).all(axis=1).sum())
        if alike > _TWINS * len(one):
            first, second = (submission.runs[n].config.seed for n in (i, j))
            yield (
                f"seeds {first} and {second} begin alike for {alike} of {len(one)} "
                f"goals, to {_FIRST_ACTION:g}: be wary of them"
            )


def _notes(
    submission: Submission, equal: Sequence[bool], pairs: Pairs
) -> Iterator[str]:
    manifest, count = submission.manifest, len(equal)
    if more := sorted({name for c, a in pairs for name in c.row if name not in a.row}):
        yield f"not checked, as nothing here measures it: {', '.join(more):.200}"
    if count < (every := submission.scores("success").size):
        yield f"time was up after {count} of {every} episodes, of goals in random order"
    there, here = manifest["packages"] | manifest["machine"], versions() | machine()
    changed = [
        f"{name} {there[name]} (here {now})"
        for name, now in here.items()
        if there.get(name, now) != now
    ]
    if changed:
        yield f"submitted with {', '.join(changed)}"
    elif not all(equal):
        yield (
            f"{count - sum(equal)} of {count} episodes are not equal to the bit, "
            "though processor and packages are called the same: be wary of small "
            "differences"
        )
    yield from _twins(submission)
    dataset = manifest["dataset"] or {}
    data = recorded().get(dataset.get("recipe", ""), {}).get("data_sha256")
    if data is not None and dataset.get("data_sha256") != data:
        yield "the dataset is not the one on record, to the bit"
    yield "only the policy is scored: algorithm, dataset and training are not checked"
