"""A robot's file that lacks something: one line, whatever the engine."""

from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import pytest

from marl_mm.cli import main
from marl_mm.robot import description
from marl_mm.sim.config import ENGINES, is_installed


def edited(change: str, name: str) -> str:
    """The URDF, one of whose joints or links is changed."""
    text = (resources.files("marl_mm.robot") / "miranda.urdf").read_text()
    root = ElementTree.fromstring(text)
    (part,) = root.findall(f"*[@name='{name}']")
    if change == "renamed":
        part.set("name", "elbow")
    elif change == "fixed":
        part.set("type", "fixed")
    elif change == "removed":
        root.remove(part)
    text = ElementTree.tostring(root, encoding="unicode")
    return text[: text.index(name)] if change == "cut off" else text


@pytest.mark.parametrize(
    ("change", "name", "complaint"),
    [
        ("renamed", "panda_joint7", "joint panda_joint7 is missing, expected revolute"),
        ("fixed", "left_wheel_joint", "left_wheel_joint is fixed, expected continuous"),
        ("removed", "panda_finger_joint1", "panda_finger_joint1 is missing"),
        ("removed", "grasp", "link grasp is missing"),
        ("cut off", "panda_joint3", "is no URDF: unclosed token"),
    ],
)
def test_what_is_missing_is_told_in_one_line(
    change: str,
    name: str,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "miranda.urdf"
    file.write_text(edited(change, name))
    monkeypatch.setattr(description, "files", lambda package: tmp_path)
    for engine in filter(is_installed, ENGINES):
        words = ["eval", "pd", "--episodes", "1", "--workers", "1", "--engine", engine]
        assert main(words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert str(file) in line and complaint in line
