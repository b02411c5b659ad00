"""The comparison of two layouts names everything that differs, and nothing else."""

from dataclasses import replace

import pytest

from marl_mm.envs.tasks.grasp import LAYOUT as HANDLING
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.errors import LayoutError
from marl_mm.layout import Entry, Layout
from marl_mm.layout_diff import layout_diff, refuse_other_layout

HAND, BALANCE = REACH.team


def test_equal_layouts_do_not_differ() -> None:
    again = Layout.from_json(REACH.to_json())
    assert layout_diff(REACH, again) == []
    refuse_other_layout("mine", REACH, "theirs", again)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (HANDLING, "state opening \\[m\\] in \\[-0.1, 0.1\\], .*: only there"),
        (replace(REACH, team=(BALANCE, HAND)), "order of the agent: end_effector, bal"),
        (
            replace(REACH, team=(HAND, replace(BALANCE, sees=("base_x",)))),
            "agent balance sees end_effector_x \\(not there\\)",
        ),
        (
            replace(REACH, state=(*REACH.state[1:7], REACH.state[0], *REACH.state[7:])),
            "order of the state",
        ),
        (
            replace(REACH, action=(*REACH.action[:3], Entry("alpha", "1", 0.0, 0.5))),
            "action alpha \\[1\\] in \\[0, 1\\] \\(there alpha \\[1\\] in \\[0, 0.5\\]",
        ),
        (
            replace(
                REACH,
                state=(*REACH.state[:5], Entry("base_yaw", "deg"), *REACH.state[6:]),
            ),
            "state base_yaw \\[rad\\] \\(there base_yaw \\[deg\\]\\)",
        ),
        (replace(REACH, compared=("base_x", "base_y", "base_yaw")), "compared"),
    ],
)
def test_a_difference_names_the_entries(other: Layout, named: str) -> None:
    with pytest.raises(LayoutError, match=named):
        refuse_other_layout("mine", REACH, "theirs", other)
    assert layout_diff(other, REACH)


def test_a_joint_policy_does_not_mind_who_sets_what() -> None:
    """And a decentralised one does."""
    swapped = replace(REACH, team=(replace(HAND, sees=BALANCE.sees), BALANCE))
    refuse_other_layout("joint", REACH, "theirs", swapped, agents=False)
    with pytest.raises(LayoutError, match="end_effector sees goal_x"):
        refuse_other_layout("team", REACH, "theirs", swapped)
