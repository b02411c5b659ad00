"""Versions of the packages that decide the bytes of a file."""

import platform
from importlib.metadata import PackageNotFoundError, version

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


def versions(*others: str) -> dict[str, str]:
    """Versions of Python, of this package, of ``PACKAGES`` and of others, by name."""
    from marl_mm import __version__  # of this code, whatever is installed

    numbers = {"python": platform.python_version(), "marl-mm": __version__}
    for name in (*PACKAGES, *others):
        try:
            numbers[name] = version(name)
        except PackageNotFoundError:  # a copied folder, not an installed package
            numbers[name] = "unknown"
    return numbers
