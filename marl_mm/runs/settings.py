"""Settings by name: checked, replaced, and taken from what was done before."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from marl_mm.algorithms.config_checks import LARGEST
from marl_mm.declared import plain
from marl_mm.errors import UsageError, meant
from marl_mm.received import Refusal, check_kind
from marl_mm.words import refuse_control_characters

T = TypeVar("T")

MOST_GOALS = 25_000
"""Largest number of goals of an evaluation. They are drawn before it begins, and their
rows of about 550 bytes are a record of at most ``RECORD_BYTES``."""

_GOALS = ("episodes", "eval_episodes", "curve_episodes", "goals")

_WORDS = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    NoneType: "None",
}
"""Types of settings in words."""

SEEDS_OF_RUNS = 2**31
"""Number of seeds of runs: two streams of each, which torch's generator of 32 bits
tells apart."""

SEEDS = 2**63 - 1
"""Number of seeds: whole numbers of 64 bits, and the next of each."""


def with_settings(owner: str, record: T, settings: Mapping[str, Any]) -> T:
    """A dataclass, and those in its fields, with some settings replaced by name.

    Args:
        owner: Name of what is set, for messages.
        record: Frozen dataclass with the defaults.
        settings: New values by name.

    Raises:
        UsageError: If no field has a name, or a value is of another type.
    """
    refuse_unknown(owner, settings, setting_names(record))
    return with_values(record, settings, owner)


def refuse_unknown(owner: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Raise a UsageError for the first name of a setting that is not known."""
    known = sorted(known)
    for name in names:
        if name not in known:
            raise UsageError(
                f"{owner} has no setting {name!r}{meant(name, known)}, expected some "
                f"of {', '.join(known)}"
            )


def flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Recorded settings, nested as their dataclasses are, by their own names."""
    return {
        name: value
        for key, inner in values.items()
        for name, value in (
            flat(inner) if isinstance(inner, Mapping) else {key: inner}
        ).items()
    }


def with_values(
    record: T, values: Mapping[str, Any], owner: str, refusal: Refusal = UsageError
) -> T:
    """A dataclass, and those in its fields, with the values that are known by name.

    Args:
        record: Frozen dataclass with the defaults.
        values: New values by name; a list stands for a tuple.
        owner: Name of where they are from, for messages.
        refusal: Class of the error.

    Raises:
        MarlMmError: If a value is of another type than its field.
    """
    hints = get_type_hints(type(record))
    changes: dict[str, Any] = {}
    for field in fields(record):  # type: ignore[arg-type]
        before = getattr(record, field.name)
        if _is_record(before):
            changes[field.name] = with_values(before, values, owner, refusal)
        elif field.name in values or isinstance(before, np.generic):
            value = plain(values.get(field.name, before))
            kind = hints[field.name]
            several = isinstance(before, tuple) or get_origin(kind) is tuple
            if several and isinstance(value, list | tuple):
                value = tuple(map(plain, value))
            if isinstance(value, str) and refusal is UsageError:
                refuse_control_characters(f"{owner}: {field.name}", value)
            where = f"{owner}: {field.name} is {value!r:.80}"
            try:
                check_kind(value, kind, where, refusal)
            except refusal:
                raise refusal(f"{where}, expected {_in_words(kind)}") from None
            kinds = {kind, *get_args(kind)}
            parts = value if isinstance(value, tuple) else (value,)
            odd = any(isinstance(part, bool) for part in parts)
            if odd and kinds & {int, float} and bool not in kinds:
                raise refusal(f"{where}, expected a number")
            changes[field.name] = value
    return replace(record, **changes)  # type: ignore[type-var]


def _in_words(kind: Any) -> str:
    """The type of a setting in a user's words."""
    if kind in _WORDS:
        return _WORDS[kind]
    parts = get_args(kind)
    if get_origin(kind) is Literal:
        return " or ".join(map(str, parts))
    if get_origin(kind) is tuple:
        words = ("..." if part is Ellipsis else _in_words(part) for part in parts)
        return f"({', '.join(words)})"
    return " or ".join(map(_in_words, parts)) or getattr(kind, "__name__", str(kind))


def setting_names(record: Any) -> Iterator[str]:
    """Names of the settings of a dataclass, and of those in its fields."""
    for field in fields(record):
        value = getattr(record, field.name)
        if _is_record(value):
            yield from setting_names(value)
        else:
            yield field.name


def _is_record(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type)


def as_path(value: object, name: str, expected: str = "a folder") -> Path:
    """A path that somebody named.

    Args:
        value: The path, or its text.
        name: Name of the parameter.
        expected: What the path should be of, for the message.

    Raises:
        UsageError: If it is empty, or no path.
    """
    if value == "" or not isinstance(value, str | Path):
        raise UsageError(f"`{name}` is {value!r:.80}, expected {expected}")
    return Path(value)


def check_positive(**values: int) -> None:
    """Raise a UsageError for the first number that is not whole, below 1 or endless."""
    for name, value in values.items():
        if not is_whole(value):
            raise UsageError(f"`{name}` is {value!r:.40}, expected a whole number")
        if value < 1:
            raise UsageError(f"`{name}` is {value}, expected >= 1")
        most = MOST_GOALS if name in _GOALS else LARGEST
        if value > most:
            raise UsageError(f"`{name}` is {value}, expected at most {most:,}")


def check_config(config: object, own: object) -> None:
    """Raise a UsageError for a config that is not of the class of another."""
    if not isinstance(config, type(own)):
        expected = type(own).__name__
        raise UsageError(f"`config` is {config!r:.80}, expected a {expected}")


def check_seeds(seeds: Sequence[int]) -> None:
    """Raise a UsageError for seeds of runs that are none, named twice, or no seeds."""
    if isinstance(seeds, str) or not hasattr(seeds, "__len__"):
        raise UsageError(f"`seeds` is {seeds!r:.40}, expected several, such as (0, 1)")
    if len(seeds) == 0:
        raise UsageError("`seeds` names no seed, expected at least one")
    for seed in seeds:
        check_seed(seed, SEEDS_OF_RUNS)
    if len(set(seeds)) < len(seeds):
        listed = " ".join(map(str, seeds))
        raise UsageError(f"`seeds` is {listed}, expected each seed once")


def check_seed(seed: int, number: int = SEEDS) -> None:
    """Raise a UsageError for a seed that is negative, or not below their number."""
    if not is_whole(seed):
        raise UsageError(f"the seed is {seed!r:.40}, expected a whole number")
    if seed < 0:
        raise UsageError(f"the seed is {seed}, expected >= 0")
    if seed >= number:
        raise UsageError(f"the seed is {seed}, expected below {number:,}")


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number, of Python's or of NumPy's."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def refuse_both(resume: bool, overwrite: bool) -> None:
    """Raise a UsageError if both `resume` and `overwrite` are set."""
    if resume and overwrite:
        raise UsageError(
            "`resume=True` and `overwrite=True` contradict each other: choose one"
        )


def check_device(device: str) -> None:
    """Raise a UsageError for "cuda" where there is no GPU."""
    if device == "cpu":
        return
    import torch  # takes a second

    if not torch.cuda.is_available():
        raise UsageError(
            "`device` is cuda, but torch finds no such GPU: use `device` cpu, or "
            "install a torch that is built for yours"
        )
