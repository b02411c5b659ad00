"""Claims about code under test, and findings on whether they hold."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.errors import MarlMmError


class BrokenClaimError(MarlMmError):
    """A claim does not hold."""


Claim = Callable[[Any], object]
"""Raises a ``BrokenClaimError`` if it does not hold of a subject."""


@dataclass(frozen=True)
class Finding:
    """Whether a claim holds."""

    subject: str
    """Kind and name of the thing that was tested, such as ``task Reach-v0``."""

    claim: str
    """Text of the claim."""

    broken: str = ""
    """Reason for which the claim does not hold; empty if it holds."""


def examine(subject: str, about: Any, claims: Mapping[str, Claim]) -> Iterator[Finding]:
    """Check claims one after the other; code that fails breaks its claim.

    Args:
        subject: Kind and name of the thing under test, for the findings.
        about: The thing under test, which the claims are called with.
        claims: Claims by their texts.
    """
    for text, claim in claims.items():
        try:
            claim(about)
        except BrokenClaimError as error:
            yield Finding(subject, text, str(error))
        except Exception as error:  # whatever a stranger's code raises
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            yield Finding(subject, text, f"{reason:.300}")
        else:
            yield Finding(subject, text)


def demand(holds: Any, why: str) -> None:
    """Raise unless something holds.

    Raises:
        BrokenClaimError: With the reason.
    """
    if not holds:
        raise BrokenClaimError(why)


def demand_same(first: np.ndarray, then: np.ndarray, name: str) -> None:
    """Raise unless two arrays are equal to the bit.

    Args:
        first: The values of the first time.
        then: The values of the second time.
        name: Name of the values, for the message.

    Raises:
        BrokenClaimError: Naming the first place that differs.
    """
    first, then = np.asarray(first), np.asarray(then)
    same = first.shape == then.shape and first.dtype == then.dtype
    here, there = (f"{each.dtype} of shape {each.shape}" for each in (first, then))
    demand(same, f"{name}: {here}, then {there}")
    if first.tobytes() != then.tobytes():
        where = np.argwhere(~((first == then) | ((first != first) & (then != then))))
        place = where[0].tolist() if len(where) else "a sign"
        raise BrokenClaimError(f"{name} differ at {place}")


def demand_refused(act: Callable[[], object], what: str) -> None:
    """Raise unless something is refused with an error of the package.

    Raises:
        BrokenClaimError: If it is not refused, or with another error.
    """
    try:
        act()
    except MarlMmError:
        return
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise BrokenClaimError(f"{what} ends in {reason:.200}") from error
    raise BrokenClaimError(f"{what} is accepted")
