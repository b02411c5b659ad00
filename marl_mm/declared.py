"""Checks of dataclasses of settings, whose fields become options and records."""

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from marl_mm.errors import UsageError

ADDED = MappingProxyType({"added": True})
"""Metadata of a field that older records lack."""


def plain(value: Any) -> Any:
    """Numbers of NumPy's as Python's own, which JSON has."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def like(value: Any, usual: Any, name: str) -> Any:
    """A value as records have it: of the usual one's kind, of Python's own numbers.

    Args:
        value: The value; lists become tuples, whole numbers floats where one is usual.
        usual: Value of the kind, nested as it is; None is of every kind.
        name: Name of the value, for the message.

    Raises:
        UsageError: If it is of another kind, or not finite.
    """
    value = plain(value)
    if is_record(usual):
        return _record_like(value, usual, name)
    if isinstance(usual, tuple):
        if not isinstance(value, list | tuple) or len(usual) not in (0, len(value)):
            raise UsageError(f"{name} is {value!r:.60}, expected {len(usual)} numbers")
        of_each = usual or [None] * len(value)
        return tuple(like(*pair, name) for pair in zip(value, of_each, strict=True))
    if usual is None:
        return tuple(like(v, None, name) for v in value) if _is_list(value) else value
    truth = isinstance(value, bool)
    if isinstance(usual, float) and isinstance(value, int | float) and not truth:
        if value == usual or abs(value) <= sys.float_info.max:
            return float(value)
    elif isinstance(value, type(usual)) and truth == isinstance(usual, bool):
        return value
    kind = "a finite number" if isinstance(usual, float) else type(usual).__name__
    raise UsageError(f"{name} is {value!r:.60}, expected {kind}")


def make_like_defaults(config: Any, of: str = "") -> None:
    """Turn a frozen dataclass's fields into values ``like`` their defaults.

    Args:
        config: Instance that is being made.
        of: Beginning of the fields' names in messages, such as "robot.".

    Raises:
        UsageError: Naming the first field that is of another kind, or not finite.
    """
    for field in fields(config):
        usual = None if field.default is MISSING else field.default
        if field.default_factory is not MISSING:
            usual = field.default_factory()
        value = like(getattr(config, field.name), usual, f"{of}{field.name}")
        object.__setattr__(config, field.name, value)


def is_record(value: Any) -> bool:
    """Whether it has named fields: a dataclass's instance or a named tuple."""
    named = is_dataclass(value) or hasattr(value, "_asdict")
    return named and not isinstance(value, type)


def _record_like(value: Any, usual: Any, name: str) -> Any:
    if not isinstance(value, type(usual)):
        raise UsageError(f"{name} is {value!r:.60}, expected a {type(usual).__name__}")
    known = (
        usual._fields if hasattr(usual, "_fields") else [f.name for f in fields(usual)]
    )
    changes = {}
    for field in known:
        given = getattr(value, field)
        kept = like(given, getattr(usual, field), f"{name}.{field}")
        if kept is not given:
            changes[field] = kept
    if not changes:
        return value
    named = hasattr(value, "_replace")
    return value._replace(**changes) if named else replace(value, **changes)


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple) and not is_record(value)


def defaults(kind: type) -> dict[str, object]:
    """Default values of a dataclass by field.

    Raises:
        UsageError: If it is no dataclass, or a field has no default.
    """
    if not isinstance(kind, type) or not is_dataclass(kind):
        raise UsageError(f"{kind!r} is no dataclass, expected a frozen one of settings")
    values: dict[str, object] = {}
    for field in fields(kind):
        if field.default is not MISSING:
            values[field.name] = field.default
        elif field.default_factory is not MISSING:
            values[field.name] = field.default_factory()
        else:
            name = f"{kind.__name__}.{field.name}"
            raise UsageError(f"{name} has no default: give it one")
    return values


def as_record(settings: Any) -> dict[str, Any]:
    """Fields of a dataclass for records, nested as it is.

    What is ``ADDED`` is left out at its default: the record is as it was before.
    """
    record = asdict(settings)
    for field in fields(settings):
        if field.metadata == ADDED and record[field.name] == field.default:
            del record[field.name]
    return record


def with_added(record: Mapping[str, Any], settings: Any) -> dict[str, Any]:
    """A record of such settings, with the defaults of what ``as_record`` leaves out.

    Only so completed do two records show all that differs.
    """
    added = {f.name: f.default for f in fields(settings) if f.metadata == ADDED}
    return {**added, **record}


def check_positive(config: Any, *fields: str, of: str = "") -> None:
    """Raise for a number that is not above 0, or an interval that is not.

    Args:
        config: Config with the numbers and intervals.
        fields: Names of their fields.
        of: Beginning of the fields' names in messages, such as "wall.".

    Raises:
        UsageError: Naming the first such field.
    """
    for name in fields:
        value = getattr(config, name)
        if isinstance(value, tuple | list):
            low, high = value
            if not 0 < low <= high < math.inf:
                raise UsageError(
                    f"{of}{name} is {low} to {high}, expected 0 < low <= high"
                )
        elif not 0 < value < math.inf:
            raise UsageError(f"{of}{name} is {value}, expected > 0")


def check_not_negative(config: Any, *fields: str, of: str = "") -> None:
    """Raise for a number below 0, or one that is not finite; likewise.

    Raises:
        UsageError: Naming the first such field.
    """
    for name in fields:
        if not 0 <= (value := getattr(config, name)) < math.inf:
            raise UsageError(f"{of}{name} is {value}, expected >= 0")


def check_settings(
    settings: object, needed: Iterable[str] = (), taken: Iterable[str] = ()
) -> None:
    """Raise for settings that cannot be recorded, or lack a field.

    Args:
        settings: Instance of a dataclass.
        needed: Names of fields or properties that it must have.
        taken: Names that mean something else where it is recorded.

    Raises:
        UsageError: Naming the field that is missing, or whose name is taken.
    """
    kind = type(settings)
    values = defaults(kind)
    if missing := [name for name in needed if not hasattr(settings, name)]:
        raise UsageError(
            f"{kind.__name__} has no {', '.join(missing)}, which is needed"
        )
    refuse_taken(kind, values, taken)


def refuse_taken(kind: type, names: Iterable[str], taken: Iterable[str]) -> None:
    """Raise for settings whose names are taken.

    Raises:
        UsageError: Naming the first of them.
    """
    if clash := sorted({*names} & {*taken}):
        raise UsageError(
            f"{kind.__name__}.{clash[0]} has the name of something else that is "
            "recorded or asked for beside it: give it another name"
        )
