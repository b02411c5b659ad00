"""A block, its stand and the gripper in MuJoCo."""

import numpy as np

from marl_mm.robot.description import RobotConfig
from marl_mm.robot.names import (
    ARM_LINKS,
    BASE_LINK,
    FINGER_JOINTS,
    FINGER_LINKS,
    HAND_LINK,
)
from marl_mm.sim.config import RATE, SimulationConfig
from marl_mm.sim.mujoco.engine import mujoco
from marl_mm.sim.mujoco.model import BLOCK, GROUND, PARTED, STAND
from marl_mm.sim.scene import Scene
from marl_mm.sim.world import Touches

HIDDEN = (0.0, 0.0, -10.0)
"""Position of a stand that is not there [m]."""


class MujocoHandling:
    """A block, and its stand if it has one, in a robot's world.

    Args:
        model: A model of ``handling_model`` that nobody shares; the scene's sizes and
            masses are written into it.
        data: Its data, with the robot at its start.
        robot: Start posture, with the travel of the fingers.
        config: Settings of the gripper.
        scene: Block and stand.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: RobotConfig,
        config: SimulationConfig,
        scene: Scene,
    ) -> None:
        self._model, self._data, self._config, self.scene = model, data, config, scene
        names = (model.geom(number).name for number in range(model.ngeom))
        self._names = [name.split(".")[0] for name in names]  # of links and things
        self._fingers = [int(model.joint(name).dofadr[0]) for name in FINGER_JOINTS]
        self._places = [int(model.joint(name).qposadr[0]) for name in FINGER_JOINTS]
        self._body, self._last_link = model.body(BLOCK).id, model.body(ARM_LINKS[-1]).id
        self._weld = model.equality("weld").id
        self._no_slip, model.opt.noslip_iterations = model.opt.noslip_iterations, 0
        self._pads = [model.pair(f"{BLOCK}+{name}").id for name in FINGER_LINKS]
        self.rows = np.zeros(2, np.int64)
        """See ``Native``; so are the next two."""

        self.fingers = np.array([self._places, self._fingers])
        self.grip = model.joint(FINGER_JOINTS[0]).range.copy()
        self._build(scene, robot.initial_finger)

    def _build(self, scene: Scene, travel: float) -> None:
        """Write the scene into the model, and put the block in its place."""
        model, data, block = self._model, self._data, scene.block
        geom, body = model.geom(BLOCK).id, self._body
        half = np.divide(block.size, 2)
        model.geom_size[geom] = half
        model.geom_rbound[geom] = np.linalg.norm(half, axis=-1)
        model.body_mass[body] = block.mass
        squares = np.square(block.size)
        model.body_inertia[body] = block.mass / 12 * (squares.sum() - squares)
        for number in range(model.npair):
            name = model.pair(number).name
            if name.startswith(f"{BLOCK}+") and model.pair_dim[number] > 1:
                model.pair_friction[number, :2] = block.friction
        model.pair_friction[model.pair(f"{GROUND}+{BLOCK}").id, :2] = block.friction
        stand = model.geom(STAND).id
        place: tuple[float, ...] = HIDDEN
        if scene.stand_size is not None:
            half = np.divide(scene.stand_size, 2)
            model.geom_size[stand] = half
            model.geom_rbound[stand] = np.linalg.norm(half, axis=-1)
            place = (*scene.position_w[:2], scene.stand_size[2] / 2)
        model.geom_pos[stand] = place
        self._touch_block(True)
        start = data.qpos.copy()
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        free = int(model.body_jntadr[body])
        address = int(model.jnt_qposadr[free])
        start[address : address + 7] = *scene.position_w, 1, 0, 0, 0
        start[self._places] = (
            travel if scene.stand_size is not None else block.size[0] / 2
        )
        data.qpos[:] = start
        self._drive_fingers(0.0)

    def close_gripper(self) -> None:
        """See ``Handling``."""
        if not self._data.eq_active[self._weld]:
            self._drive_fingers(-self._config.grip_speed)

    def open_gripper(self) -> None:
        """See ``Handling``."""
        self._model.opt.noslip_iterations = 0
        self._drive_fingers(self._config.grip_speed)

    def squeeze(self) -> None:
        """See ``Handling``; a motor that is held back presses with all its force.

        Slip is removed from here on, until the gripper opens. It takes 9 us a step, and
        a block that stands by itself does not slip.
        """
        self._model.opt.noslip_iterations = self._no_slip
        self.close_gripper()

    def weld(self) -> None:
        """See ``Handling``."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        place, turn = data.xpos, data.xquat
        inverse, way, rotation = np.empty(4), np.empty(3), np.empty(4)
        mujoco.mju_negQuat(inverse, turn[self._last_link])
        mujoco.mju_rotVecQuat(way, place[self._body] - place[self._last_link], inverse)
        mujoco.mju_mulQuat(rotation, inverse, turn[self._body])
        # Anchor in the block, position and orientation of the block in the hand.
        model.eq_data[self._weld, :10] = 0, 0, 0, *way, *rotation
        data.eq_active[self._weld] = True
        self._touch_block(False)
        self._drive_fingers(0.0)

    def unweld(self) -> None:
        """See ``Handling``."""
        self._data.eq_active[self._weld] = False
        self._touch_block(True)
        self._drive_fingers(self.grip[0])

    def opening(self) -> float:
        """See ``Handling``."""
        return float(self._data.qpos[self._places].sum())

    def block_w(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Handling``."""
        place = self._model.jnt_qposadr[self._model.body_jntadr[self._body]]
        w, x, y, z = self._data.qpos[place + 3 : place + 7]
        return self._data.qpos[place : place + 3].copy(), np.array([x, y, z, w])

    def touches(self) -> Touches:
        """See ``Handling``."""
        fingers, stand, ground, collisions = set(), False, False, set()
        for first, second in self._contacts():
            pair = {first, second}
            if BLOCK in pair:
                (other,) = pair - {BLOCK}
                if other in FINGER_LINKS:
                    fingers.add(other)
                elif other == STAND:
                    stand = True
                elif other == GROUND:
                    ground = True
                elif other != HAND_LINK:
                    collisions.add(f"the block and {other}")
            elif pair & {STAND, GROUND}:
                thing = STAND if STAND in pair else GROUND
                (link,) = pair - {thing}
                rolls = "wheel" in link or link.startswith(f"{BASE_LINK}_")
                if not rolls:
                    collisions.add(f"{link} and the {thing}")
            else:
                collisions.add(" and ".join(sorted(pair)))
        return Touches(len(fingers), stand, ground, min(collisions, default=""))

    def motor(self) -> list[float]:
        """Rates of the fingers' motors [m/s]."""
        speed, most = self.grip.tolist()
        travels = self._data.qpos[self._places].tolist()
        return [min(max(speed, -x * RATE), (most - x) * RATE) for x in travels]

    def _drive_fingers(self, speed: float) -> None:
        """Have both fingers slide outward at this speed [m/s] from now on."""
        self.grip[0] = speed
        gear, weld = 1, 6 * int(self._data.eq_active[self._weld])
        self.rows[:] = gear + weld, 4

    def _contacts(self) -> list[tuple[str, str]]:
        """Links or things in contact, whose normal force is above 0."""
        contact, forces, names = self._data.contact, self._data.efc_force, self._names
        pairs = zip(contact.geom.tolist(), contact.efc_address.tolist(), strict=True)
        return [
            (names[first], names[second])
            for (first, second), row in pairs
            if row >= 0 and forces[row] > 0
        ]

    def _touch_block(self, solid: bool) -> None:
        """Switch the collision of fingers and block on or off."""
        self._model.pair_margin[self._pads] = 0.0 if solid else PARTED
