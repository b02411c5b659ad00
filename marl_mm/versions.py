"""Versions of the packages that decide the bytes of a file."""

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = (
    "marl-mm",
    "pybullet",
    "pin",
    "proxsuite",
    "numba",
    "numpy",
    "torch",
    "gymnasium",
    "pettingzoo",
    "minari",
)


def versions(*others: str) -> dict[str, str]:
    """Versions of Python, of every package in ``PACKAGES`` and of others, by name."""
    found = {"python": platform.python_version()}
    for name in (*PACKAGES, *others):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # a copied folder, not an installed package
            found[name] = "unknown"
    return found
