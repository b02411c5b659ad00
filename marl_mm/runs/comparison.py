"""Comparison of a submission's episodes with the same ones run again, in words."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from scipy.special import stdtrit
from scipy.stats import binom

from marl_mm.eval.intervals import mean_interval
from marl_mm.eval.metrics import METRICS
from marl_mm.registry import BUILT_IN
from marl_mm.runs.recipes import RECIPES, recorded
from marl_mm.runs.submission import Scored, Submission
from marl_mm.versions import machine, versions

Pairs = list[tuple[Scored, Scored]]
"""Episodes of a seed: as claimed, and run again."""

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


def differing(submission: Submission, pairs: Sequence[Pairs]) -> Iterator[str]:
    """What differs beyond the last bits of another processor, in words."""
    unexplained: Pairs = []
    equal = [c.sha256 == a.sha256 for of_run in pairs for c, a in of_run]
    same_machine = sum(equal) >= _REPEATED * len(equal)
    for run, of_run in zip(submission.runs, pairs, strict=True):
        name = f"seed {run.config.seed}"
        repeated = [(c, a) for c, a in of_run if c.sha256 == a.sha256]
        changed = [(c, a) for c, a in of_run if c.sha256 != a.sha256]
        if forged := [pair for pair in repeated if _forged(*pair)]:
            keys = sorted({key for pair in forged for key in _forged(*pair)})
            yield (
                f"{name}: rows of goals {_goals(forged)} do not follow from their "
                f"episodes, by {', '.join(keys)}"
            )
        if strange := [pair for pair in changed if not _alike(*pair)]:
            yield (
                f"{name}: first actions of goals {_goals(strange)}, or goals, are "
                "others: these weights did not make these rows"
            )
        elif changed and same_machine:
            yield (
                f"{name}: episodes of goals {_goals(changed)} are others, while "
                f"{sum(equal)} of all {len(equal)} are equal to the bit on this machine"
            )
            continue
        unexplained += changed
    yield from beyond_chance(unexplained)


def _goals(pairs: Pairs) -> str:
    indices = sorted(claimed.row["index"] for claimed, _ in pairs)
    more = len(indices) - _LISTED
    listed = ", ".join(map(str, indices[:_LISTED]))
    return f"{listed} and {more} more" if more > 0 else listed


def _forged(claimed: Scored, again: Scored) -> set[str]:
    """Keys by which a row is not that of the same episode; plug-ins add others."""
    there, here = dict(claimed.row), dict(again.row)
    both = {k: (there[k], here[k]) for k in there.keys() & here.keys()}
    odd = {
        k for k, (c, a) in both.items() if c != a and (c == c or a == a)
    }  # NaN is NaN
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


def beyond_chance(pairs: Pairs) -> Iterator[str]:
    """Outcomes of too many goals, and means that differ beyond chance, in words."""
    flipped = [(c, a) for c, a in pairs if c.row["success"] != a.row["success"]]
    if len(flipped) > binom.isf(1 - _CONFIDENCE, len(pairs), _FLIPPED):
        yield (
            f"success: {len(flipped)} of {len(pairs)} goals have another outcome than "
            "is claimed, more than another processor explains"
        )
    for name, margin in _MARGINS.items():
        rows = [(float(c.row[name]), float(a.row[name])) for c, a in pairs]  # type: ignore[literal-required]
        differences = np.array([claimed - again for claimed, again in rows])
        if len(differences) == 0 or abs(mean := float(differences.mean())) <= margin:
            continue
        low, high = mean, mean
        if len(differences) > 1:
            low, high = mean_interval(differences, _CONFIDENCE)
        if len(differences) > 1 and name == "return":
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


def other_recipe(submission: Submission) -> Iterator[str]:
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


def notes(submission: Submission, equal: Sequence[bool], pairs: Pairs) -> Iterator[str]:
    """What a reader should know of the comparison, in words."""
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
