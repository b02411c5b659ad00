"""The gripper, the block that it handles, its stand, and their contacts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from marl_mm.robot.names import ARM_LINKS, BASE_LINK, FINGER_LINKS, HAND_LINK
from marl_mm.sim.bullet.engine import pybullet
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.scene import Scene
from marl_mm.sim.world import Touches


class BulletHandling:
    """A block, and its stand if it has one, in a robot's world.

    Args:
        client: PyBullet's id of the world.
        robot: Body of the robot.
        links: Numbers of its links by name.
        ground: Body of the ground.
        config: Settings of gripper and friction.
        scene: Block and stand.
        visual: Whether to draw them.
    """

    def __init__(
        self,
        client: int,
        robot: int,
        links: Mapping[str, int],
        ground: int,
        config: SimulationConfig,
        scene: Scene,
        visual: bool,
    ) -> None:
        self._client, self._robot, self._ground = client, robot, ground
        self._config, self._visual, self.scene = config, visual, scene
        self._fingers = [links[name] for name in FINGER_LINKS]
        self._hand = links[HAND_LINK]
        self._arm = {links[name] for name in (*ARM_LINKS, HAND_LINK, *FINGER_LINKS)}
        self._names = {number: name for name, number in links.items()}
        self._weld: int | None = None
        self._squeezing = False
        self._exclude_pairs(links)
        self._couple_fingers()
        self._stand = self._load_stand(scene)
        self._block = self._load_block(scene)
        if scene.stand_size is None:
            self._put_fingers(scene.block.size[0] / 2)

    def close_gripper(self) -> None:
        """Close from now on, until something is there to squeeze."""
        if not self._squeezing and self._weld is None:
            self._drive_fingers(-self._config.grip_speed)

    def open_gripper(self) -> None:
        """Open from now on, and stay so."""
        self._squeezing = False
        self._drive_fingers(self._config.grip_speed)

    def squeeze(self) -> None:
        """Press what is between the pads from now on, with the grip's force.

        A motor that is to close at some speed presses with as much force as the solver
        finds in its iterations; this is the force itself.
        """
        self._drive_fingers(0.0, force=0.0)
        self._squeezing = True

    def tick(self) -> None:
        """Apply the forces that last for one step."""
        if self._squeezing:
            pybullet.setJointMotorControlArray(
                self._robot,
                self._fingers,
                pybullet.TORQUE_CONTROL,
                forces=[-self._config.grip_force] * 2,
                physicsClientId=self._client,
            )

    def opening(self) -> float:
        """Distance between the finger tips [m]."""
        states = pybullet.getJointStates(
            self._robot, self._fingers, physicsClientId=self._client
        )
        return float(states[0][0] + states[1][0])

    def block_w(self) -> tuple[np.ndarray, np.ndarray]:
        """The block's centre, shape (3,) [m], and quaternion x, y, z, w."""
        place, turn = pybullet.getBasePositionAndOrientation(
            self._block, physicsClientId=self._client
        )
        return np.array(place), np.array(turn)

    def pose(self, place_w: np.ndarray, turn: np.ndarray, travel: float) -> None:
        """Put block and fingers somewhere, to draw them there.

        Args:
            place_w: Centre of the block, shape (3,) [m].
            turn: Orientation of the block: x, y, z, w.
            travel: Travel of each finger [m].
        """
        pybullet.resetBasePositionAndOrientation(
            self._block, place_w, turn, physicsClientId=self._client
        )
        self._put_fingers(travel)

    def weld(self) -> None:
        """Fix the block to the hand where it is now, and the fingers.

        They stay solid for each other: to exclude them (``setCollisionFilterPair``) in
        a world that has begun takes the load off the drive wheels, which then slip.
        """
        hand = pybullet.getLinkState(
            self._robot, self._hand, physicsClientId=self._client
        )
        inverse = pybullet.invertTransform(*hand[:2])  # of its centre of mass
        place, turn = pybullet.getBasePositionAndOrientation(
            self._block, physicsClientId=self._client
        )
        place_h, turn_h = pybullet.multiplyTransforms(*inverse, place, turn)
        self._weld = pybullet.createConstraint(
            self._robot,
            self._hand,
            self._block,
            -1,
            pybullet.JOINT_FIXED,
            (0, 0, 0),
            place_h,
            (0, 0, 0),
            turn_h,
            physicsClientId=self._client,
        )
        self._drive_fingers(0.0)

    def unweld(self) -> None:
        """Release the block from the hand."""
        pybullet.removeConstraint(self._weld, physicsClientId=self._client)
        self._weld = None

    def touches(self) -> Touches:
        """Contacts of the last step with a force above 0."""
        fingers, stand, ground, collisions = set(), False, False, set()
        for contact in self._contacts(self._block):
            body, link = contact[2], contact[4]
            if body == self._robot and link in self._fingers:
                fingers.add(link)
            elif body == self._robot and link != self._hand:
                collisions.add(f"the block and {self._names[link]}")
            stand |= body == self._stand
            ground |= body == self._ground
        for contact in self._contacts(self._robot):
            body, link, own = contact[2], contact[3], self._names[contact[3]]
            if body == self._ground and link in self._arm:
                collisions.add(f"{own} and the ground")
            elif body == self._stand:
                collisions.add(f"{own} and the stand")
            elif body == self._robot:
                collisions.add(f"{own} and {self._names[contact[4]]}")
        return Touches(len(fingers), stand, ground, min(collisions, default=""))

    def _contacts(self, body: int) -> list[tuple[Any, ...]]:
        """PyBullet's contacts of a body with a force above 0."""
        found = pybullet.getContactPoints(body, physicsClientId=self._client)
        return [contact for contact in found if contact[9] > 0]

    def _exclude_pairs(self, links: Mapping[str, int]) -> None:
        """Switch off self-collisions of the robot, but of the arm with the base."""
        near = {links[name] for name in ARM_LINKS[:2]}
        for number in links.values():
            for other in links.values():
                wanted = {number, other} & {links[BASE_LINK]} and (
                    {number, other} & (self._arm - near)
                )
                if number < other and not wanted:
                    pybullet.setCollisionFilterPair(
                        self._robot,
                        self._robot,
                        number,
                        other,
                        0,
                        physicsClientId=self._client,
                    )

    def _couple_fingers(self) -> None:
        """Couple the fingers by a gear, as the hand has a single motor."""
        left, right = self._fingers
        gear = pybullet.createConstraint(
            self._robot,
            left,
            self._robot,
            right,
            jointType=pybullet.JOINT_GEAR,
            jointAxis=(0, 1, 0),
            parentFramePosition=(0, 0, 0),
            childFramePosition=(0, 0, 0),
            physicsClientId=self._client,
        )
        pybullet.changeConstraint(
            gear, gearRatio=-1, erp=0.1, maxForce=50, physicsClientId=self._client
        )
        for finger in self._fingers:
            pybullet.changeDynamics(
                self._robot,
                finger,
                lateralFriction=1.0,
                spinningFriction=self._config.spinning_friction,
                physicsClientId=self._client,
            )

    def _drive_fingers(self, speed: float, force: float | None = None) -> None:
        force = self._config.grip_force if force is None else force
        pybullet.setJointMotorControlArray(
            self._robot,
            self._fingers,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[speed] * 2,
            forces=[force] * 2,
            physicsClientId=self._client,
        )

    def _put_fingers(self, travel: float) -> None:
        """Place both fingers at this travel [m]."""
        for finger in self._fingers:
            pybullet.resetJointState(
                self._robot, finger, travel, 0, physicsClientId=self._client
            )

    def _load_stand(self, scene: Scene) -> int:
        if scene.stand_size is None:
            return -2
        x, y, _ = scene.position_w
        height = scene.stand_size[2]
        place = (x, y, height / 2)
        return self._box(0, scene.stand_size, place, (0.55, 0.45, 0.35, 1), 1.0)

    def _load_block(self, scene: Scene) -> int:
        block = scene.block
        color = (0.85, 0.55, 0.10, 1)
        return self._box(
            block.mass, block.size, scene.position_w, color, block.friction
        )

    def _box(
        self,
        mass: float,
        size: tuple[float, float, float],
        place: tuple[float, float, float],
        color: tuple[float, float, float, float],
        friction: float,
    ) -> int:
        client, half = self._client, [edge / 2 for edge in size]
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        visual = -1
        if self._visual:
            visual = pybullet.createVisualShape(
                pybullet.GEOM_BOX,
                halfExtents=half,
                rgbaColor=color,
                physicsClientId=client,
            )
        body: int = pybullet.createMultiBody(
            mass, shape, visual, place, physicsClientId=client
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=friction,
            spinningFriction=self._config.spinning_friction,
            linearDamping=0,
            angularDamping=0,
            physicsClientId=client,
        )
        return body
