"""Settings that declarations bring: what options and records are made of."""

from collections.abc import Iterable
from dataclasses import MISSING, fields, is_dataclass

from marl_mm.errors import UsageError


def defaults(kind: type) -> dict[str, object]:
    """Default values of a dataclass by field.

    Raises:
        UsageError: If it is no dataclass, or a field has no default.
    """
    if not isinstance(kind, type) or not is_dataclass(kind):
        raise UsageError(f"{kind!r} is no dataclass, expected a frozen one of settings")
    values: dict[str, object] = {}
    for one in fields(kind):
        if one.default is not MISSING:
            values[one.name] = one.default
        elif one.default_factory is not MISSING:
            values[one.name] = one.default_factory()
        else:
            raise UsageError(f"{kind.__name__}.{one.name} has no default: give it one")
    return values


def check_settings(
    settings: object, needed: Iterable[str] = (), taken: Iterable[str] = ()
) -> None:
    """Raise for settings that cannot be recorded, or lack what is needed.

    Args:
        settings: A dataclass's instance.
        needed: Names that it must have.
        taken: Names that mean something else where it is recorded.

    Raises:
        UsageError: Naming what is missing, or has another's name.
    """
    kind = type(settings)
    known = defaults(kind)
    if missing := [name for name in needed if not hasattr(settings, name)]:
        raise UsageError(
            f"{kind.__name__} has no {', '.join(missing)}, which is needed"
        )
    refuse_taken(kind, known, taken)


def refuse_taken(kind: type, names: Iterable[str], taken: Iterable[str]) -> None:
    """Raise for settings that have the names of others beside them.

    Raises:
        UsageError: Naming them.
    """
    if clash := sorted({*names} & {*taken}):
        raise UsageError(
            f"{kind.__name__}.{clash[0]} has the name of something else that is "
            "recorded or asked for beside it: give it another name"
        )
