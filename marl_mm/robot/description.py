"""One URDF for both engines, with the base's uncertain inertia filled in."""

from dataclasses import dataclass
from importlib import resources
from xml.etree import ElementTree

BODY_SIZE = (0.90, 0.58, 0.30)
"""Base body, length x width x height [m] (MiR data sheet; see the URDF)."""

WHEEL_RADIUS = 0.0625
"""[m] (MiR data sheet)."""

WHEEL_SEPARATION = 0.4452
"""Between the two drive wheels [m] (MiR data sheet)."""

CASTER_X = (0.341, -0.270)
"""Front and rear casters in the base frame [m] (public mir_robot description)."""

CASTER_Y = 0.203
"""Casters stand at plus and minus this [m] (public mir_robot description)."""


@dataclass(frozen=True)
class RobotConfig:
    """What public descriptions of the base disagree about, and the start posture."""

    base_mass: float = 82.0
    """Mass of the base without its wheels of 1 kg each [kg]."""

    base_com_b: tuple[float, float, float] = (0.0, 0.0, 0.20)
    """Centre of mass of the base without its wheels, in the base frame [m]."""

    initial_joints: tuple[float, ...] = (0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 2.356)
    """Arm joints at the start of an episode, shape (7,) [rad] (paper, Sec. 5.1)."""

    initial_finger: float = 0.04
    """Travel of each finger [m]; the paper's 0.08 is the opening between the two."""


def urdf_xml(config: RobotConfig) -> str:
    """The robot's URDF as a string, with the base's mass properties of ``config``."""
    text = resources.files("marl_mm.robot").joinpath("miranda.urdf").read_text()
    root = ElementTree.fromstring(text)
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
    return ElementTree.tostring(root, encoding="unicode")


def _set(parent: ElementTree.Element, tag: str, values: dict[str, str]) -> None:
    element = parent.find(tag)
    assert element is not None
    element.attrib.update(values)
