"""Plug-ins: code of others that registers tasks, algorithms, collectors and the like.

A plug-in is a Python file or module, and loading it runs its code. Only plug-ins that
the user names are loaded, and installed ones with an entry point of the group
``marl_mm.plugins``. Nothing in a dataset or a checkpoint ever loads a plug-in.
"""

import hashlib
import importlib
import importlib.util
import sys
import traceback
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from marl_mm.errors import MarlMmError, PluginError, UsageError
from marl_mm.registry import BUILT_IN, registered_by

GROUP = "marl_mm.plugins"
"""Name of the group of entry points of installed plug-ins."""

_PREFIX = "marl_mm_plugin_"
"""Prefix of the names of modules that are made from files."""


@dataclass(frozen=True)
class Plugin:
    """A plug-in that has been loaded."""

    name: str
    """Name of the file or module."""

    source: str
    """Absolute path of the file, or name of the module, which loads it again."""

    sha256: str
    """SHA-256 of the code, in hex digits."""


_loaded: dict[str, Plugin] = {}
"""Plug-ins by name, in the order in which they were loaded."""


def load(source: str | Path) -> Plugin:
    """Load a plug-in, which runs its code.

    A file with the same bytes as a loaded plug-in is that plug-in.

    Args:
        source: Path of a file that ends in .py, or name of a module.

    Raises:
        UsageError: If there is no such file or module, or another plug-in has its name.
        PluginError: If its code fails, or the file was loaded and has changed since.
    """
    text = str(source)
    if not text:
        raise UsageError("no plug-in named: expected a file, or a module's name")
    is_file = text.endswith(".py")
    if not is_file and not all(map(str.isidentifier, text.split("."))):
        raise UsageError(f"no plug-in {text}: expected FILE.py, or a module's name")
    name = Path(text).name if is_file else text
    digest = ""
    if is_file:
        if not Path(text).is_file():
            raise UsageError(f"no plug-in {text}: expected a file, or a module's name")
        path = Path(text).resolve()
        text = str(path)
        digest = _sha256(path)
        for plugin in _loaded.values():
            if plugin.sha256 == digest:  # such as an installed copy
                return plugin
    before = _loaded.get(name)
    if before is not None:
        if before.source != text:
            raise UsageError(
                f"two plug-ins are called {name}: {before.source} and {text}"
            )
        _check_unchanged(before)
        return before
    module = _run(name, text, is_file)
    # Of the bytes before they ran: that they have changed since is then noticed.
    _loaded[name] = Plugin(name, text, digest or _digest(module))
    return _loaded[name]


def load_all(sources: Iterable[str]) -> None:
    """Load the plug-ins of installed packages, and then these."""
    load_installed()
    for source in sources:
        load(source)


def load_installed() -> None:
    """Load the plug-ins of installed packages; a failure is only a warning."""
    for entry in entry_points(group=GROUP):
        if entry.module not in _loaded:
            try:
                load(entry.module)
            except MarlMmError as error:
                warnings.warn(
                    f"the installed plug-in {entry.name} is left out: {error}",
                    stacklevel=2,
                )


def loaded() -> tuple[Plugin, ...]:
    """The plug-ins that have been loaded, in order."""
    return tuple(_loaded.values())


def record(*origins: str) -> dict[str, str]:
    """SHA-256 of the plug-ins among some origins, by name, for a run or a dataset.

    Args:
        origins: Names of plug-ins and modules; see ``Registry.origin``.
    """
    digests = {}
    for origin in origins:
        if origin in _loaded:
            digests[origin] = _loaded[origin].sha256
        elif origin != BUILT_IN and origin in sys.modules:
            digests[origin] = _digest(sys.modules[origin])
    return digests


class Carried:
    """The plug-ins of this process, for another process: unpickling loads them.

    It has to be pickled before objects of the plug-ins' classes. To pickle it raises
    a ``PluginError`` if a file has changed since it was loaded.
    """

    def __reduce__(self) -> tuple[object, ...]:
        for plugin in _loaded.values():
            _check_unchanged(plugin)
        return load_all, ([plugin.source for plugin in _loaded.values()],)


def _check_unchanged(plugin: Plugin) -> None:
    """Raise if a plug-in's file no longer has the code that runs in this process."""
    path = Path(plugin.source)
    if path.suffix != ".py":
        return
    if not path.is_file() or _sha256(path) != plugin.sha256:
        raise PluginError(
            f"plug-in {plugin.name}: {path} has changed, or is gone, since it was "
            "loaded: start Python anew"
        )


def _run(name: str, source: str, is_file: bool) -> ModuleType:
    try:
        with registered_by(name):
            return _imported_file(Path(source)) if is_file else _imported(source)
    except MarlMmError as error:
        raise PluginError(f"plug-in {name}: {error}") from error
    except ModuleNotFoundError as error:
        if error.name and (source == error.name or source.startswith(f"{error.name}.")):
            raise UsageError(
                f"no plug-in {source!r}: expected a file that ends in .py, or a module "
                "that can be imported"
            ) from error
        raise PluginError(f"plug-in {name} fails: {error}") from error
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        inner = [frame for frame in frames if is_file and frame.filename == source]
        line = (inner or frames)[-1].lineno
        line = error.lineno if isinstance(error, SyntaxError) else line
        text = error.msg if isinstance(error, SyntaxError) else error
        reason = " ".join(f"{type(error).__name__}: {text}".split())
        raise PluginError(
            f"plug-in {name} fails: {reason:.300} (line {line})"
        ) from error


def _imported(module: str) -> ModuleType:
    return importlib.import_module(module)


def _imported_file(path: Path) -> ModuleType:
    """The module of a file, under a name by which pickles of its classes find it."""
    name = _PREFIX + path.stem.replace("-", "_")
    there = getattr(sys.modules.get(name), "__file__", str(path))
    if Path(there).resolve() != path.resolve():
        raise UsageError(f"{there} counts as the same plug-in: rename one of them")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(path.parent))  # for its own imports
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.path.remove(str(path.parent))
    return module


def _digest(module: ModuleType) -> str:
    """SHA-256 of a module's file, or of all Python files of a package."""
    file = getattr(module, "__file__", None)
    if file is None:
        return ""
    path = Path(file)
    if path.name == "__init__.py":
        return _sha256(*sorted(path.parent.rglob("*.py")))
    return _sha256(path)


def _sha256(*paths: Path) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()
