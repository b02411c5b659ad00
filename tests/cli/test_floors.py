"""Imports point down only: each package knows what is below it."""

import ast
import os
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2] / "marl_mm"

FLOORS = (
    ("robot",),
    ("sim",),
    ("control",),
    ("envs",),
    ("datasets",),
    ("algorithms",),
    ("collectors",),  # a learnt policy may collect
    ("eval",),
    ("runs",),
    ("eval.studies", "eval.bench", "contracts"),
    ("commands",),
)
"""Packages from the ground up; those of one floor may know each other."""

HEIGHT = {package: floor for floor, row in enumerate(FLOORS) for package in row}


def package_of(module: str) -> str | None:
    """The package of a module below ``marl_mm``, the innermost that has a floor."""
    parts = module.split(".")
    inner = [".".join(parts[:count]) for count in (2, 1)]
    return next((name for name in inner if name in HEIGHT), None)


def files() -> Iterator[Path]:
    """All modules, those of linked folders by way of the link."""
    for folder, _, names in os.walk(ROOT, followlinks=True):
        yield from (
            Path(folder, name) for name in sorted(names) if name.endswith(".py")
        )


def imports() -> Iterator[tuple[str, str, Path, int]]:
    """Every import of one package of ours by another, late ones too."""
    for path in files():
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        package = package_of(name)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            for known in names:
                other = package_of(known.removeprefix("marl_mm."))
                if known.startswith("marl_mm.") and other and package:
                    yield package, other, path, node.lineno


def test_imports_point_down() -> None:
    found = list(imports())
    assert len(found) > 300, "the folders that are linked are read, too"
    wrong = {
        f"{path.relative_to(ROOT)}:{line} imports {other}"
        for package, other, path, line in found
        if HEIGHT[other] > HEIGHT[package]
    }
    assert not wrong, "\n".join(sorted(wrong))


def test_only_the_command_line_knows_commands() -> None:
    for path in files():
        if path.parent.name != "commands" and path != ROOT / "cli.py":
            assert "marl_mm.commands" not in path.read_text(), path


def test_an_engine_is_imported_in_one_file_alone() -> None:
    found = {
        (engine, path.relative_to(ROOT).as_posix())
        for path in files()
        for engine in re.findall(
            r"^\s*(?:import|from) (pybullet|mujoco)\b", path.read_text(), re.MULTILINE
        )
    }
    assert found == {
        ("pybullet", "sim/bullet/engine.py"),
        ("mujoco", "sim/mujoco/engine.py"),
    }
