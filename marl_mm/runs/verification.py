"""What comes of scoring a submission again, and its record beside the submission."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from marl_mm.errors import SubmissionError
from marl_mm.received import check_kind, read_json
from marl_mm.runs.submission import Submission

Verdict = Literal["equal to the bit", "equal within intervals", "not equal"]


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


def stands(earlier: Mapping[str, Any], result: Verification) -> bool:
    """Whether an earlier verification knows more.

    It has found what is false, or has scored more episodes.
    """
    if result.verdict == "not equal" or result.scored == result.episodes:
        return False
    more: bool = earlier["scored"] > result.scored
    return more or earlier["verdict"] == "not equal"
