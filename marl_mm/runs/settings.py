"""Settings by name: checked, replaced, and taken from what was done before."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, get_type_hints

from typeguard import TypeCheckError, check_type

from marl_mm.algorithms.config_checks import LARGEST
from marl_mm.errors import UsageError, meant

T = TypeVar("T")

MOST_GOALS = 1_000_000
"""Largest number of goals of an evaluation, which are drawn before it begins."""

_GOALS = ("episodes", "eval_episodes", "curve_episodes", "goals")

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
    kinds = dict(_kinds(record))
    for name, value in settings.items():
        if name not in kinds:
            raise UsageError(
                f"{owner} has no setting {name!r}{meant(name, kinds)}, expected some "
                f"of {', '.join(sorted(kinds))}"
            )
        try:
            check_type(value, kinds[name])
        except TypeCheckError as error:
            why = " ".join(str(error).split())
            raise UsageError(f"{owner}: {name} is {value!r:.80}, {why}") from None
    return with_values(record, settings)


def with_values(record: T, values: Mapping[str, Any]) -> T:
    """A dataclass, and those in its fields, with the values that are known by name."""
    changes: dict[str, Any] = {}
    for field in fields(record):  # type: ignore[arg-type]
        before = getattr(record, field.name)
        if _is_record(before):
            changes[field.name] = with_values(before, values)
        elif field.name in values:
            value = values[field.name]
            changes[field.name] = tuple(value) if isinstance(before, tuple) else value
    return replace(record, **changes)  # type: ignore[type-var]


def _kinds(record: Any) -> Iterator[tuple[str, Any]]:
    """Names and types of the settings of a dataclass, and of those in its fields."""
    hints = get_type_hints(type(record))
    for field in fields(record):
        value = getattr(record, field.name)
        if _is_record(value):
            yield from _kinds(value)
        else:
            yield field.name, hints[field.name]


def _is_record(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type)


def check_positive(**values: float) -> None:
    """Raise a UsageError for the first setting below 1, or too large to have an end."""
    for name, value in values.items():
        if value < 1:
            raise UsageError(f"`{name}` is {value}, expected >= 1")
        most = MOST_GOALS if name in _GOALS else LARGEST
        if value > most:
            raise UsageError(f"`{name}` is {value}, expected at most {most:,}")


def check_seeds(seeds: Sequence[int]) -> None:
    """Raise a UsageError for seeds of runs that are none, named twice, or no seeds."""
    if not seeds:
        raise UsageError("`seeds` names no seed, expected at least one")
    if len(set(seeds)) < len(seeds):
        listed = " ".join(map(str, seeds))
        raise UsageError(f"`seeds` is {listed}, expected each seed once")
    for seed in seeds:
        check_seed(seed, SEEDS_OF_RUNS)


def check_seed(seed: int, number: int = SEEDS) -> None:
    """Raise a UsageError for a seed that is negative, or not below their number."""
    if seed < 0:
        raise UsageError(f"the seed is {seed}, expected >= 0")
    if seed >= number:
        raise UsageError(f"the seed is {seed}, expected below {number:,}")


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
