"""One URDF for both engines, with the base's uncertain inertia filled in."""

import math
import operator
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import as_file, files
from typing import NamedTuple
from xml.etree import ElementTree

from marl_mm.declared import check_positive, make_like_defaults
from marl_mm.errors import UsageError
from marl_mm.robot.names import (
    ARM_LINKS,
    BASE_LINK,
    FINGER_LINKS,
    HAND_LINK,
    JOINTS,
    LINKS,
    WHEEL_JOINTS,
)

BODY_SIZE = (0.90, 0.58, 0.30)
"""Base body, length x width x height [m] (MiR data sheet; see the URDF)."""

WHEEL_RADIUS = 0.0625
"""Radius of the drive wheels [m] (MiR data sheet)."""

WHEEL_SEPARATION = 0.4452
"""Distance between the two drive wheels [m] (MiR data sheet)."""

CASTER_X = (0.341, -0.270)
"""Positions of front and rear casters along x of the base frame [m] (public mir_robot
description)."""

CASTER_Y = 0.203
"""Distance of the casters from the base's midline [m] (public mir_robot
description)."""


@dataclass(frozen=True)
class RobotConfig:
    """Uncertain mass properties of the base, and the start posture."""

    base_mass: float = 82.0
    """Mass of the base without its wheels of 1 kg each [kg]."""

    base_com_b: tuple[float, float, float] = (0.0, 0.0, 0.20)
    """Centre of mass of the base without its wheels, in the base frame [m]."""

    initial_joints: tuple[float, ...] = (0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 2.356)
    """Arm joints at the start of an episode, shape (7,) [rad] (paper, Sec. 5.1)."""

    initial_finger: float = 0.04
    """Travel of each finger [m]; the paper's 0.08 is the opening between the two."""

    def __post_init__(self) -> None:
        make_like_defaults(self, "robot.")
        check_positive(self, "base_mass", of="robot.")


PAD_SIZE = (0.020, 0.014, 0.022)
"""Edges of a finger's pad, a box [m]; ours, after the finger's mesh."""

PAD_Z = 0.0425
"""Position of the pad's centre along the finger [m]; the grasp frame is at 0.045."""


HAND_BOX = ((0.064, 0.206, 0.092), (0.0, -0.002, 0.020))
"""Edges and centre, in the hand's frame, of the box around the hand's mesh [m]."""


class Capsule(NamedTuple):
    """A cylinder with half balls as its ends, in the frame of a link."""

    link: str
    """Name of the link."""

    start: tuple[float, float, float]
    """Centre of one ball [m]."""

    end: tuple[float, float, float]
    """Centre of the other [m]."""

    radius: float
    """Radius [m]."""


ARM_CAPSULES = tuple(
    Capsule(ARM_LINKS[number], start, end, radius)
    for number, start, end, radius in (
        (1, (0.0, 0.0, -0.333), (0.0, 0.0, -0.05), 0.06),
        (2, (0.0, 0.0, -0.06), (0.0, 0.0, 0.06), 0.06),
        (3, (0.0, 0.0, -0.22), (0.0, 0.0, -0.07), 0.06),
        (4, (0.0, 0.0, -0.06), (0.0, 0.0, 0.06), 0.06),
        (5, (0.0, 0.0, -0.31), (0.0, 0.0, -0.21), 0.06),
        (5, (0.0, 0.08, -0.20), (0.0, 0.08, -0.06), 0.025),
        (6, (0.0, 0.0, -0.07), (0.0, 0.0, 0.01), 0.05),
        (7, (0.0, 0.0, -0.06), (0.0, 0.0, 0.08), 0.04),
        (7, (0.039, 0.039, 0.082), (0.046, 0.046, 0.082), 0.03),
    )
)
"""Solid shapes of the arm without meshes (franka_description, franka_arm.xacro)."""


def urdf_xml(config: RobotConfig, solid: bool = False) -> str:
    """The robot's URDF as a string, with the base's mass properties of ``config``.

    Args:
        config: Mass properties.
        solid: Give arm, hand and fingers collision shapes: the meshes' convex hulls,
            and a box for each finger's pad.

    Raises:
        UsageError: If the URDF describes no robot that can be simulated.
    """
    root = _root()
    inertial = root.find("link[@name='base_link']/inertial")
    assert inertial is not None
    length, width, height = (side * side for side in BODY_SIZE)
    mass = config.base_mass
    moments = {
        "ixx": mass / 12 * (width + height),
        "iyy": mass / 12 * (length + height),
        "izz": mass / 12 * (length + width),
    }
    _set(inertial, "origin", {"xyz": " ".join(map(repr, config.base_com_b))})
    _set(inertial, "mass", {"value": repr(mass)})
    _set(inertial, "inertia", {key: repr(value) for key, value in moments.items()})
    if solid:
        _make_solid(root)
    return ElementTree.tostring(root, encoding="unicode")


def _root() -> ElementTree.Element:
    """The URDF's tree.

    Raises:
        UsageError: If it describes no robot that can be simulated.
    """
    with as_file(files("marl_mm.robot") / "miranda.urdf") as path:
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as error:
            raise UsageError(f"{path} is no URDF: {error}") from None
        if wrong := [*_wrong_joints(root), *_wrong_links(root)]:
            raise UsageError(f"{path}: {'; '.join(wrong)}")
    return root


def _wrong_joints(root: ElementTree.Element) -> Iterator[str]:
    """What is wrong with the joints."""
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for name, kind in JOINTS.items():
        found = joints[name].get("type") if name in joints else "missing"
        if found != kind:
            yield f"joint {name} is {found}, expected {kind}"
    ordered = sorted(joints.keys() & JOINTS.keys(), key=[*JOINTS].index)
    if [name for name in joints if name in JOINTS] != ordered:  # as engines number them
        yield f"joints come in another order than {', '.join(ordered)}"
    for name, joint in joints.items():
        moves = joint.get("type")
        if moves == "fixed":
            continue
        if name not in JOINTS:
            yield f"joint {name} is {moves}, expected fixed: the controller has no such"
        for effect in ("damping", "friction"):  # one engine has it, one does not
            if abs(_number(joint, "dynamics", effect)) > 0:
                yield f"joint {name} has {effect}, which the controller's model lacks"
        for limit in ("effort", "velocity"):
            if not _number(joint, "limit", limit) > 0:
                yield f"joint {name} has no {limit} above 0 in its limit"
        ends = (_number(joint, "limit", end) for end in ("lower", "upper"))
        if moves != "continuous" and not operator.lt(*ends):
            yield f"joint {name} has no lower limit below its upper one"


def _wrong_links(root: ElementTree.Element) -> Iterator[str]:
    """What is wrong with the links."""
    links = {str(link.get("name")): link for link in root.findall("link")}
    yield from (f"link {name} is missing" for name in LINKS if name not in links)
    above = {
        _value(joint, "child", "link"): _value(joint, "parent", "link")
        for joint in root.findall("joint")
    }
    tops = {name: name for name in links}
    for _ in links:
        tops = {name: above.get(top, top) for name, top in tops.items()}
    if lost := [name for name, top in tops.items() if top != BASE_LINK]:
        yield f"links {', '.join(lost)} do not hang on {BASE_LINK}"
    for name, link in links.items():
        if not _number(link, "inertial/mass", "value") > 0:  # engines guess another
            yield f"link {name} has no mass above 0"
        elif link.find("inertial/inertia") is None:
            yield f"link {name} has no inertia"
    for name, side in zip(WHEEL_JOINTS, (1, -1), strict=True):
        joint, y = f"joint[@name='{name}']", side * WHEEL_SEPARATION / 2
        wheel = _value(root, f"{joint}/child", "link")
        ball = f"link[@name='{wheel}']/collision/geometry/sphere"
        radius = _number(root, ball, "radius")
        there = _number(root, f"{joint}/origin", "xyz", 1)
        if not (math.isclose(radius, WHEEL_RADIUS) and math.isclose(there, y)):
            yield (
                f"joint {name} carries no ball of radius {WHEEL_RADIUS} m at y {y:.7g} "
                "m, which are constants of description.py"
            )


def _value(root: ElementTree.Element, path: str, name: str) -> str:
    """An attribute of the first element there; "none" without."""
    element = root.find(path)
    return "none" if element is None else element.get(name, "none")


def _number(root: ElementTree.Element, path: str, name: str, place: int = 0) -> float:
    """The same, as a number, or the one at this place among several; NaN without."""
    with suppress(ValueError, IndexError):
        return float(_value(root, path, name).split()[place])
    return math.nan


def _make_solid(root: ElementTree.Element) -> None:
    meshes = {name: f"link{i}.obj" for i, name in enumerate(ARM_LINKS) if i}
    for name, file in {**meshes, HAND_LINK: "hand.obj"}.items():
        mesh = {"filename": f"franka_panda/meshes/collision/{file}"}
        _add_collision(root, name, "0 0 0", "mesh", mesh)
    for name, side in zip(FINGER_LINKS, (1, -1), strict=True):
        place = f"0 {side * PAD_SIZE[1] / 2} {PAD_Z}"
        size = {"size": " ".join(map(repr, PAD_SIZE))}
        _add_collision(root, name, place, "box", size)


def _add_collision(
    root: ElementTree.Element,
    link: str,
    place: str,
    shape: str,
    attributes: dict[str, str],
) -> None:
    parent = root.find(f"link[@name='{link}']")
    assert parent is not None
    collision = ElementTree.SubElement(parent, "collision")
    ElementTree.SubElement(collision, "origin", {"xyz": place})
    geometry = ElementTree.SubElement(collision, "geometry")
    ElementTree.SubElement(geometry, shape, attributes)


def _set(parent: ElementTree.Element, tag: str, values: dict[str, str]) -> None:
    element = parent.find(tag)
    if element is None:
        element = ElementTree.SubElement(parent, tag)
    element.attrib.update(values)
