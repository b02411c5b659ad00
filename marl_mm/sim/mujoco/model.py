"""Models of MuJoCo: the robot from its URDF on a plane, and a block to handle.

Joint frames, masses and inertias are those of the URDF.
"""

from functools import lru_cache

import numpy as np

from marl_mm.robot.description import (
    ARM_CAPSULES,
    HAND_BOX,
    PAD_SIZE,
    PAD_Z,
    RobotConfig,
    urdf_xml,
)
from marl_mm.robot.model import GRAVITY
from marl_mm.robot.names import (
    ARM_LINKS,
    BASE_LINK,
    FINGER_JOINTS,
    FINGER_LINKS,
    GRASP_FRAME,
    HAND_LINK,
    WHEEL_JOINTS,
)
from marl_mm.sim.config import RATE, SimulationConfig
from marl_mm.sim.mujoco.engine import mujoco

GROUND = "ground"
"""Name of the plane."""

IMPEDANCE = {"wheel": 0.995, "caster": 0.95}
"""Impedance of the contacts with the ground (``solimp``): casters are softer, so that
the drive wheels carry most of the weight, as in PyBullet."""

CONTACT_TIME = 0.04
"""Time constant of these contacts (``solref``) [s]; with two steps, 8 ms, the base
hops."""

IMPEDANCE_RATIO = 5.0
"""Impedance of friction over that of normal forces (``impratio``)."""

ITERATIONS = 50
"""Largest number of iterations of the contact solver, which takes 1.2 on average."""

HELD_RATIO = 10.0
"""``impratio`` where friction holds a block: with ``NO_SLIP`` iterations, 3 kg creep by
0.11 mm in a second at rest, at a friction coefficient of 0.6."""

NO_SLIP = 5
"""Iterations that remove the slip of soft friction (``noslip_iterations``)."""

HELD_TIME = 0.01
"""Time constant of contacts of solid parts and of the weld [s]."""

HELD_IMPEDANCE = 0.99
"""Impedance of contacts of solid parts."""

BLOCK, STAND = "block", "stand"
"""Names of the block and of its stand."""

PARTED = -10.0
"""Margin of pairs that do not touch whatever their distance [m]."""

MOTOR_TIME = 2 / RATE
"""Time constant of the wheels' motors in the model [s]. It has no effect, as their
reference is written in each step."""

# Its warnings become errors here; it would print them, and append them to a file.
_log = mujoco.MjLogConfig.get()
_log.logto_console = _log.logto_file = False
_log.set()


@lru_cache(maxsize=16)
def robot_model(robot: RobotConfig, config: SimulationConfig) -> mujoco.MjModel:
    """The robot on its plane, with locked fingers; nothing but its wheels is solid."""
    spec = _robot(robot, config)
    for name in FINGER_JOINTS:
        joint = spec.joint(name)
        finger, way = joint.parent, np.empty(3)
        mujoco.mju_rotVecQuat(way, joint.axis * robot.initial_finger, finger.quat)
        finger.pos = finger.pos + way
        spec.delete(joint)
    return spec.compile()


@lru_cache(maxsize=16)
def handling_model(
    robot: RobotConfig, config: SimulationConfig, friction: bool
) -> mujoco.MjModel:
    """The robot with a gripper and solid parts, a block and a stand.

    Sizes, places and masses of block and stand are those of no scene yet.

    Args:
        robot: Mass properties and start posture.
        config: Settings of motors and friction.
        friction: Whether pads have to hold the block by friction.
    """
    spec = _robot(robot, config)
    if friction:
        spec.option.impratio, spec.option.noslip_iterations = HELD_RATIO, NO_SLIP
    for name in FINGER_JOINTS:
        _drive(spec.joint(name), config.grip_force)
    couple = spec.add_equality(
        name="gear",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=FINGER_JOINTS[0],
        name2=FINGER_JOINTS[1],
        solref=(MOTOR_TIME, 1),
    )
    couple.data[:5] = 0, 1, 0, 0, 0
    block = spec.worldbody.add_body(name=BLOCK)
    block.add_freejoint()
    spec.add_equality(
        name="weld",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=ARM_LINKS[-1],
        name2=BLOCK,
        active=False,
        solref=(MOTOR_TIME, 1),
        solimp=(0.9999, 0.9999, 0.001, 0.5, 2),
    )
    _make_solid(spec, config)
    return spec.compile()


def _robot(robot: RobotConfig, config: SimulationConfig) -> mujoco.MjSpec:
    """The robot on its plane, with fingers that slide freely."""
    spec = mujoco.MjSpec.from_string(urdf_xml(robot))
    option = spec.option
    option.timestep, option.gravity = 1 / RATE, (0, 0, -GRAVITY)
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.impratio, option.iterations = IMPEDANCE_RATIO, ITERATIONS
    off = mujoco.mjtDisableBit
    option.disableflags |= (
        off.mjDSBL_SENSOR
        | off.mjDSBL_ISLAND
        | off.mjDSBL_MIDPHASE
        | off.mjDSBL_AUTORESET
        | off.mjDSBL_EULERDAMP
    )
    for name in WHEEL_JOINTS:
        _drive(spec.joint(name), config.wheel_force)
    spec.body(BASE_LINK).add_freejoint()
    spec.body(GRASP_FRAME).add_site(name=GRASP_FRAME)
    spec.worldbody.add_geom(
        name=GROUND, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1)
    )
    _touch_ground(spec, config)
    return spec


def _drive(joint: mujoco.MjsJoint, force: float) -> None:
    """Give a joint a motor of this largest force [N] or torque [N m].

    The motor is dry friction about a moving reference: a bounded force that gives the
    joint its speed within the step, as PyBullet's motor does.
    """
    joint.frictionloss = force
    joint.solref_friction = (MOTOR_TIME, 1)
    joint.solimp_friction = (0.9999, 0.9999, 0.001, 0.5, 2)


def _touch_ground(spec: mujoco.MjSpec, config: SimulationConfig) -> None:
    """Let wheels and casters touch the ground, and nothing else touch anything."""
    for number, geom in enumerate(spec.geoms):
        geom.contype = geom.conaffinity = 0
        geom.mass = 0.0
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.name = BASE_LINK
        if geom.type != mujoco.mjtGeom.mjGEOM_SPHERE:
            continue
        geom.name = f"{geom.parent.name}_{number}"
        wheel = geom.parent.name != BASE_LINK
        impedance = IMPEDANCE["wheel" if wheel else "caster"]
        spec.add_pair(
            geomname1=GROUND,
            geomname2=geom.name,
            condim=3 if wheel else 1,
            friction=(config.wheel_friction, config.wheel_friction, 0, 0, 0),
            solref=(CONTACT_TIME, 1),
            solimp=(impedance, impedance, 0.001, 0.5, 2),
        )


def _make_solid(spec: mujoco.MjSpec, config: SimulationConfig) -> None:
    """Give arm, hand, fingers, block and stand shapes, and say which may touch."""
    box, capsule = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
    shapeless = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    arm = []
    for number, part in enumerate(ARM_CAPSULES):
        geom = spec.body(part.link).add_geom(
            name=f"{part.link}.{number}",
            type=capsule,
            fromto=(*part.start, *part.end),
            size=(part.radius, 0, 0),
            **shapeless,
        )
        arm.append(geom.name)
    edges, place = HAND_BOX
    half = tuple(edge / 2 for edge in edges)
    boxes = [(HAND_LINK, HAND_LINK, half, place)]
    pad = tuple(edge / 2 for edge in PAD_SIZE)
    for name, side in zip(FINGER_LINKS, (1, -1), strict=True):
        boxes.append((name, name, pad, (0.0, side * pad[1], PAD_Z)))
    boxes.append((BLOCK, BLOCK, (0.025, 0.025, 0.025), (0.0, 0.0, 0.0)))
    boxes.append(("world", STAND, (0.05, 0.05, 0.05), (0.0, 0.0, 0.0)))
    for body, name, size, position in boxes:
        parent = spec.worldbody if body == "world" else spec.body(body)
        mass = {"mass": 1.0} if name == BLOCK else {}
        parent.add_geom(
            name=name, type=box, size=size, pos=position, **{**shapeless, **mass}
        )
    spin = config.spinning_friction
    rough, smooth = (1.0, 1.0, spin, 0, 0), (0.0, 0.0, 0, 0, 0)
    parts = [*arm, HAND_LINK, *FINGER_LINKS]
    over_base = [name for name in parts if not name.startswith(ARM_LINKS[1])]
    pairs = [(BASE_LINK, name) for name in over_base]
    pairs += [(thing, name) for thing in (GROUND, STAND, BLOCK) for name in parts]
    pairs += [(STAND, BASE_LINK), (BLOCK, BASE_LINK), (BLOCK, STAND), (GROUND, BLOCK)]
    for first, second in pairs:
        grips = first in (BLOCK, STAND, GROUND) and second in (
            *FINGER_LINKS,
            BLOCK,
            STAND,
        )
        spec.add_pair(
            name=f"{first}+{second}",
            geomname1=first,
            geomname2=second,
            condim=4 if grips else 1,
            friction=rough if grips else smooth,
            solref=(HELD_TIME, 1),
            solimp=(HELD_IMPEDANCE, HELD_IMPEDANCE, 0.001, 0.5, 2),
        )
