"""Versions of the packages that decide the bytes of a file."""

import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import metadata
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

from marl_mm.errors import UsageError
from marl_mm.sim.config import ENGINES, Engine

PACKAGES = (
    "pybullet",
    "mujoco-core",
    "pin",
    "proxsuite",
    "numba",
    "numpy",
    "torch",
    "gymnasium",
    "pettingzoo",
    "minari",
)


def engine_text(engine: Engine, packages: Mapping[str, str] | None = None) -> str:
    """An engine with its version, such as "mujoco 4.0.0".

    Args:
        engine: Name of the engine.
        packages: Versions by package; default those of now.
    """
    package, _ = ENGINES[engine]
    version = (versions() if packages is None else packages).get(package, "")
    return f"{engine} {version}".strip()


def versions(*others: str) -> dict[str, str]:
    """Versions of Python, of this package, of ``PACKAGES`` and of others, by name."""
    from marl_mm import __version__  # of this code, whatever is installed

    numbers = {"python": platform.python_version(), "marl-mm": __version__}
    for name in (*PACKAGES, *others):
        numbers[name] = _installed(name)
    return numbers


@cache  # reading one takes 10 ms
def _installed(name: str) -> str:
    try:
        return metadata.version(name)
    except PackageNotFoundError:  # a copied folder, not an installed package
        return "unknown"


def machine() -> dict[str, str]:
    """Processor and system of this machine, which decide the last bits of numbers."""
    name, info = platform.machine(), Path("/proc/cpuinfo")
    lines = info.read_text("utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    return {"processor": (models or [name])[0], "system": f"{platform.system()} {name}"}


def refuse_missing(extra: str, packages: Iterable[str]) -> None:
    """Raise where packages of an optional extra are not installed.

    Raises:
        UsageError: Naming them, and how they are installed.
    """
    if missing := [name for name in packages if find_spec(name) is None]:
        names = ", ".join(missing)
        raise UsageError(f"{names} missing: pip install -e '.[{extra}]'")
