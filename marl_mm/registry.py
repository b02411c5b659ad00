"""What there is of a kind, by name: built in, from plug-ins, or registered by hand."""

import difflib
import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Generic, TypeVar

from marl_mm.errors import UsageError

T = TypeVar("T")

BUILT_IN = "marl_mm"
"""Origin of what comes with the package."""

_origin: list[str] = []
"""The plug-ins being loaded, the innermost last."""


@contextmanager
def registered_by(origin: str) -> Iterator[None]:
    """Note where what is registered in this block comes from."""
    _origin.append(origin)
    try:
        yield
    finally:
        _origin.pop()


class Registry(Generic[T]):
    """Things of one kind by name, in the order in which they were added.

    Args:
        kind: What they are, in the singular, for messages.
        modules: Modules that add the built-in ones when they are imported.
    """

    def __init__(self, kind: str, modules: Sequence[str] = ()) -> None:
        self.kind = kind
        self._modules = list(modules)
        self._things: dict[str, T] = {}
        self._origins: dict[str, str] = {}

    def add(self, name: str, thing: T) -> T:
        """Register a thing.

        Raises:
            UsageError: If the name makes no sense, or another thing has it.
        """
        if not name or any(mark in name for mark in " /\\\n\t"):
            raise UsageError(
                f"{self.kind} {name!r}: expected a name without spaces and slashes"
            )
        origin = _origin[-1] if _origin else _module_of(thing)
        before = self._origins.get(name)
        if before is not None and before != origin:
            raise UsageError(
                f"{self.kind} {name!r} of {origin} exists already, from {before}: "
                "give it another name"
            )
        self._things[name], self._origins[name] = thing, origin
        return thing

    def names(self) -> tuple[str, ...]:
        """All names, the built-in ones first."""
        self._load()
        return tuple(self._things)

    def items(self) -> tuple[tuple[str, T], ...]:
        """All things with their names."""
        self._load()
        return tuple(self._things.items())

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._things

    def get(self, name: str) -> T:
        """The thing of a name.

        Raises:
            UsageError: If there is none; naming all and the nearest.
        """
        self._load()
        if name not in self._things:
            close = difflib.get_close_matches(name, self._things, 1)
            hint = f"; did you mean {close[0]}?" if close else "."
            raise UsageError(
                f"unknown {self.kind} {name!r}, expected one of "
                f"{', '.join(self._things)}{hint} What a plug-in adds needs --plugin"
            )
        return self._things[name]

    def origin(self, name: str) -> str:
        """Where a thing comes from: ``BUILT_IN``, a plug-in's name or a module."""
        self.get(name)
        return self._origins[name]

    def _load(self) -> None:
        while self._modules:
            module = self._modules.pop(0)
            with registered_by(BUILT_IN):
                importlib.import_module(module)


def _module_of(thing: object) -> str:
    module = getattr(thing, "__module__", None) or type(thing).__module__
    return BUILT_IN if module.split(".")[0] == BUILT_IN else str(module)
