"""Registries: things of a kind by name, built in, from plug-ins or added by hand."""

import importlib
import re
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Generic, TypeVar

from marl_mm.errors import UsageError, meant

T = TypeVar("T")

BUILT_IN = "marl_mm"
"""Origin of things that come with the package."""

NAME = re.compile(r"[^\W\d][\w.-]*")
"""Form of names."""

_origin: list[str] = []
"""Names of the plug-ins being loaded, the innermost last."""


_undo: list[tuple[str, Callable[[], None]]] = []
"""Modules that have registered things of plug-ins being loaded, and what takes each of
these back."""


@contextmanager
def registered_by(origin: str) -> Iterator[None]:
    """Record an origin for everything that is registered in the block.

    If the block fails, nothing of it stays registered.
    """
    _origin.append(origin)
    before, there = len(_undo), set(sys.modules)
    try:
        yield
    except BaseException:
        for module, undo in reversed(_undo[before:]):
            undo()
            if module not in there:  # a second attempt has to run it again
                sys.modules.pop(module, None)
        raise
    finally:
        del _undo[before:]
        _origin.pop()


class Registry(Generic[T]):
    """Things of one kind by name, in the order in which they were added.

    Args:
        kind: Name of the kind in the singular, for messages.
        modules: Names of the modules that add the built-in things when imported.
        of: Class of all things.
        taken: Names that nothing may have, as they mean something else.
    """

    def __init__(
        self,
        kind: str,
        modules: Sequence[str] = (),
        of: type = object,
        taken: Collection[str] = (),
    ) -> None:
        self.kind, self._of, self._taken = kind, of, taken
        self._modules, self._order = list(modules), tuple(modules)
        self._things: dict[str, T] = {}
        self._origins: dict[str, str] = {}
        self._places: dict[str, int] = {}

    def add(self, name: str, thing: T, caller: int = 1) -> T:
        """Register a thing, with the calling plug-in or module as its origin.

        Args:
            name: Name that no other thing of the kind has.
            thing: The thing.
            caller: Number of calls between here and the code that it comes from.

        Raises:
            UsageError: If the name makes no sense or is another thing's, or the thing
                is of another class.
        """
        if not isinstance(thing, self._of):
            kind = f"{self._of.__module__}.{self._of.__qualname__}"
            raise UsageError(
                f"{self.kind} {name!r} is {thing!r:.80}, expected a {kind}"
            )
        if not NAME.fullmatch(name) or name in self._taken:
            but = f", other than {', '.join(sorted(self._taken))}" * bool(self._taken)
            raise UsageError(
                f"{self.kind} {name!r}: expected a letter and then letters, digits, "
                f"'-', '_' and '.'{but}"
            )
        module = str(sys._getframe(caller).f_globals["__name__"])
        inner = module.split(".")[0] == BUILT_IN
        origin = BUILT_IN if inner else _origin[-1] if _origin else module
        before = self._origins.get(name)
        if before is not None and before != origin:
            raise UsageError(
                f"{self.kind} {name!r} of {origin} exists already, from {before}: "
                "give it another name"
            )
        if _origin and not inner:  # modules of the package stay imported
            undo = partial(self._restore, name, self._things.get(name))
            _undo.append((module, undo))
        self._things[name], self._origins[name] = thing, origin
        places = [*self._order, module]
        self._places[name] = places.index(module)
        return thing

    def _restore(self, name: str, thing: T | None) -> None:
        if thing is not None:  # of the same origin
            self._things[name] = thing
            return
        for kept in (self._things, self._origins, self._places):
            kept.pop(name, None)

    def names(self) -> tuple[str, ...]:
        """Names of all things, the built-in ones first."""
        self._load()
        return tuple(self._things)

    def items(self) -> tuple[tuple[str, T], ...]:
        """All things with their names, the built-in ones first."""
        self._load()
        return tuple(self._things.items())

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._things

    def get(self, name: str) -> T:
        """The thing of a name.

        Raises:
            UsageError: If nothing has it; the message lists all names and the nearest.
        """
        self._load()
        if not isinstance(name, str):
            raise UsageError(f"{self.kind} is {name!r:.60}, expected a name")
        if name not in self._things:
            raise UsageError(
                f"unknown {self.kind} {name!r}{meant(name, self._things)}, expected "
                f"one of {', '.join(self._things)}. What a plug-in adds needs "
                "`marl_mm.plugins.load(...)`"
            )
        return self._things[name]

    def origin(self, name: str) -> str:
        """Origin of a thing: ``BUILT_IN``, or the name of a plug-in or module."""
        self.get(name)
        return self._origins[name]

    def _load(self) -> None:
        if not self._modules:
            return
        while self._modules:
            module = self._modules.pop(0)
            try:
                importlib.import_module(module)
            except BaseException:  # such as Ctrl-C: the next call tries again
                self._modules.insert(0, module)
                raise
        # In the order of the modules, whichever was imported first.
        names = sorted(self._things, key=self._places.__getitem__)
        self._things = {name: self._things[name] for name in names}
