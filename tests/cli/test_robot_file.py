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
    elif change == "moved":
        root.remove(part)
        root.append(part)
    elif change == "emptied":
        part[:] = [inner for inner in part if inner.tag != "inertial"]
    elif change == "damped":
        ElementTree.SubElement(part, "dynamics", damping="1")
    elif change == "doubled":
        root.append(ElementTree.Element("joint", name="eighth", type="revolute"))
        root[-1].extend(part)
    elif change == "narrowed":
        (ball,) = part.findall("collision/geometry/sphere")
        ball.set("radius", "0.05")
    elif "=" in change:
        where, _, value = change.partition("=")
        element, _, attribute = where.partition(".")
        found = part.find(element)
        assert found is not None
        found.set(attribute, value)
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
        ("emptied", "panda_link5", "link panda_link5 has no mass above 0"),
        ("emptied", "base_link", "link base_link has no mass above 0"),
        ("inertial/mass.value=-1", "panda_link2", "panda_link2 has no mass above 0"),
        ("moved", "left_wheel_joint", "another order than left_wheel_joint, right"),
        ("damped", "panda_joint2", "joint panda_joint2 has damping, which the"),
        ("doubled", "panda_joint2", "joint eighth is revolute, expected fixed"),
        ("narrowed", "left_wheel", "left_wheel_joint carries no ball of radius 0.0625"),
        ("limit.velocity=0", "panda_joint2", "panda_joint2 has no velocity above 0"),
        ("limit.effort=x", "panda_joint4", "panda_joint4 has no effort above 0"),
        ("limit.lower=2", "panda_joint2", "no lower limit below its upper one"),
        ("parent.link=x", "panda_joint6", "panda_link6, panda_link7, panda_hand,"),
        ("parent.link=panda_link7", "panda_joint6", "do not hang on base_link"),
        ("origin.xyz=x 0 0", "panda_joint6", "is no robot for Pinocchio"),
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
        assert file.name in line and complaint in line
