"""Names in the URDF, in the order in which vectors hold them."""

ARM_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
"""Arm joints, shoulder to wrist; every arm vector has shape (7,) in this order."""

FINGER_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
"""Joints of the fingers."""

BASE_LINK = "base_link"
"""Link of the base's body."""

ARM_LINKS = tuple(f"panda_link{i}" for i in range(8))
"""Links of the arm, foot to flange."""

HAND_LINK = "panda_hand"
"""Link of the gripper's body."""

FINGER_LINKS = ("panda_finger1", "panda_finger2")
"""Links of the fingers, in the order of their joints."""

WHEEL_JOINTS = ("left_wheel_joint", "right_wheel_joint")
"""Joints of the drive wheels, left and right."""

GRASP_FRAME = "grasp"
"""Frame of the end-effector, between the finger tips."""

GRASP_JOINT = "grasp_joint"
"""Fixed joint that carries the grasp frame."""

JOINTS = {
    **dict.fromkeys(WHEEL_JOINTS, "continuous"),
    **dict.fromkeys(ARM_JOINTS, "revolute"),
    **dict.fromkeys(FINGER_JOINTS, "prismatic"),
    GRASP_JOINT: "fixed",
}
"""Types of the joints that a robot must have, by name."""

LINKS = (BASE_LINK, *ARM_LINKS, HAND_LINK, *FINGER_LINKS, GRASP_FRAME)
"""Links that it must have."""
