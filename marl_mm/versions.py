"""Which versions made a file: they decide its bytes."""

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
    """Version of Python and of every package that takes part, and of others."""
    found = {"python": platform.python_version()}
    for name in (*PACKAGES, *others):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # a copied folder, not an installed package
            found[name] = "unknown"
    return found
