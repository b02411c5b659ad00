"""The gripper and the block it holds, and what collides with what."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from marl_mm.robot.names import ARM_LINKS, BASE_LINK, FINGER_LINKS, HAND_LINK
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.engine import pybullet
from marl_mm.sim.scene import Scene


class Handling:
    """A block in a robot's gripper.

    Args:
        client: Of the world.
        robot: Body of the robot.
        links: Number of each of its links by name.
        config: Of the gripper.
        scene: What is there.
        visual: Whether it is to be seen.
    """

    def __init__(
        self,
        client: int,
        robot: int,
        links: Mapping[str, int],
        config: SimulationConfig,
        scene: Scene,
        visual: bool,
    ) -> None:
        self._client, self._robot = client, robot
        self._config, self._visual = config, visual
        self._fingers = [links[name] for name in FINGER_LINKS]
        self._hand = links[HAND_LINK]
        self._names = {number: name for name, number in links.items()}
        self._exclude_pairs(links)
        self._couple_fingers()
        self._block = self._load_block(scene)
        self._put_fingers(scene.block.size[0] / 2)

    def close_gripper(self) -> None:
        """Close with constant force from now on."""
        self._drive_fingers(-self._config.grip_speed)

    def block_w(self) -> tuple[np.ndarray, np.ndarray]:
        """The block's centre, shape (3,) [m], and quaternion x, y, z, w."""
        place, turn = pybullet.getBasePositionAndOrientation(
            self._block, physicsClientId=self._client
        )
        return np.array(place), np.array(turn)

    def weld(self) -> None:
        """Fix the block to the hand where it is now, whatever the fingers do."""
        hand = pybullet.getLinkState(
            self._robot, self._hand, physicsClientId=self._client
        )
        inverse = pybullet.invertTransform(*hand[:2])  # of its centre of mass
        place, turn = pybullet.getBasePositionAndOrientation(
            self._block, physicsClientId=self._client
        )
        place_h, turn_h = pybullet.multiplyTransforms(*inverse, place, turn)
        pybullet.createConstraint(
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

    def collision(self) -> str:
        """What collided that must not in the last step, in words; or nothing."""
        holding = {self._hand, *self._fingers}
        found = [
            f"the block and {self._names[contact[4]]}"
            for contact in self._contacts(self._block)
            if contact[2] == self._robot and contact[4] not in holding
        ]
        found += [
            f"{self._names[contact[3]]} and {self._names[contact[4]]}"
            for contact in self._contacts(self._robot)
            if contact[2] == self._robot
        ]
        return min(found, default="")

    def _contacts(self, body: int) -> list[tuple[Any, ...]]:
        """Of a body with others that press, as PyBullet has them."""
        found = pybullet.getContactPoints(body, physicsClientId=self._client)
        return [contact for contact in found if contact[9] > 0]

    def _exclude_pairs(self, links: Mapping[str, int]) -> None:
        """Of the robot's own links only arm and base may collide with each other."""
        arm = [links[name] for name in (*ARM_LINKS, HAND_LINK, *FINGER_LINKS)]
        near = {links[name] for name in ARM_LINKS[:2]}
        for number in links.values():
            for other in links.values():
                wanted = {number, other} & {links[BASE_LINK]} and (
                    {number, other} & (set(arm) - near)
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
        """They move as one, as the hand's single motor does."""
        one, other = self._fingers
        gear = pybullet.createConstraint(
            self._robot,
            one,
            self._robot,
            other,
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

    def _drive_fingers(self, speed: float) -> None:
        pybullet.setJointMotorControlArray(
            self._robot,
            self._fingers,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[speed] * 2,
            forces=[self._config.grip_force] * 2,
            physicsClientId=self._client,
        )

    def _put_fingers(self, travel: float) -> None:
        """Both at once to where they touch what is between them."""
        for finger in self._fingers:
            pybullet.resetJointState(
                self._robot, finger, travel, 0, physicsClientId=self._client
            )

    def _load_block(self, scene: Scene) -> int:
        """The body of a new block."""
        block, client = scene.block, self._client
        half = [edge / 2 for edge in block.size]
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        look = -1
        if self._visual:
            look = pybullet.createVisualShape(
                pybullet.GEOM_BOX,
                halfExtents=half,
                rgbaColor=(0.85, 0.55, 0.10, 1),
                physicsClientId=client,
            )
        body: int = pybullet.createMultiBody(
            block.mass, shape, look, scene.position_w, physicsClientId=client
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=block.friction,
            spinningFriction=self._config.spinning_friction,
            linearDamping=0,
            angularDamping=0,
            physicsClientId=client,
        )
        return body
