"""Claims about somebody's code, and whether they hold."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.errors import MarlMmError


class BrokenClaimError(MarlMmError):
    """A claim does not hold."""


Claim = Callable[[Any], None]
"""Raises a ``BrokenClaimError`` if it does not hold of a subject."""


@dataclass(frozen=True)
class Finding:
    """Whether a claim holds."""

    subject: str
    """Whose claim, such as ``task Reach-v0``."""

    claim: str
    """What is claimed, in words."""

    broken: str = ""
    """Why it does not hold; nothing if it holds."""


def examine(subject: str, about: Any, claims: Mapping[str, Claim]) -> Iterator[Finding]:
    """Check claims one after the other; code that fails breaks its claim.

    Args:
        subject: How findings call it.
        about: What the claims are given.
        claims: Claims by their words.
    """
    for words, claim in claims.items():
        try:
            claim(about)
        except BrokenClaimError as error:
            yield Finding(subject, words, str(error))
        except Exception as error:  # whatever a stranger's code raises
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            yield Finding(subject, words, f"{reason:.300}")
        else:
            yield Finding(subject, words)


def demand(holds: Any, why: str) -> None:
    """Raise unless something holds.

    Raises:
        BrokenClaimError: Saying why it does not.
    """
    if not holds:
        raise BrokenClaimError(why)


def demand_same(one: np.ndarray, other: np.ndarray, what: str) -> None:
    """Raise unless two arrays are equal to the bit.

    Raises:
        BrokenClaimError: Naming what differs, and where.
    """
    one, other = np.asarray(one), np.asarray(other)
    same = one.shape == other.shape and one.dtype == other.dtype
    here, there = (f"{each.dtype} of shape {each.shape}" for each in (one, other))
    demand(same, f"{what}: {here}, then {there}")
    if one.tobytes() != other.tobytes():
        where = np.argwhere(~((one == other) | ((one != one) & (other != other))))
        place = where[0].tolist() if len(where) else "a sign"
        raise BrokenClaimError(f"{what} differ at {place}")


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
