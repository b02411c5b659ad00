"""Reward and success as pure functions, vectorised over leading axes.

The same functions serve the environments and relabelling in hindsight: distance and
success depend on the goal, the other terms come from ``info``.
"""

from collections.abc import Mapping

import numpy as np

from marl_mm.envs.config import ReachConfig


def goal_distance(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Distance of what was achieved and the goal, shapes (..., 3) to (...) [m]."""
    distance: np.ndarray = np.linalg.norm(np.subtract(achieved, desired), axis=-1)
    return distance


def reached(
    distance: np.ndarray, config: ReachConfig, held: np.ndarray | bool = True
) -> np.ndarray:
    """Whether the goal counts as reached.

    Args:
        distance: Of what was achieved to it [m].
        config: The task.
        held: Whether a block that was on a stand is held.
    """
    below: np.ndarray = np.less(distance, config.success_distance)
    if config.load is not None and config.load.on_stand:
        below = below & held
    return below


def reach_reward(
    distance: np.ndarray,
    d_mm: np.ndarray,
    d_mp: np.ndarray,
    base_jerk_rms: np.ndarray,
    config: ReachConfig,
    failed: np.ndarray | bool = False,
    held: np.ndarray | bool = True,
) -> np.ndarray:
    """Eq. 6-9 of the paper and the cost of jerk.

    Args:
        distance: Of what was achieved to the goal [m].
        d_mm: End-effector to its target [m].
        d_mp: Base to its plan [m].
        base_jerk_rms: Within the step [m/s^3].
        config: Weights.
        failed: Whether a block was dropped, missed or out of reach, or something hit.
        held: As in ``reached``.
    """
    goal = np.where(reached(distance, config, held), config.goal_reward, -distance)
    if config.load is not None:
        goal = np.where(failed, config.load.failure_reward, goal)
    hand = config.ee_error_weight * d_mm
    base = config.base_error_weight * d_mp
    return np.asarray(goal - hand - base - config.jerk_weight * base_jerk_rms)


def judge(
    achieved: np.ndarray,
    desired: np.ndarray,
    costs: Mapping[str, np.ndarray],
    config: ReachConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Reward and termination of steps by other goals, shapes (n, 3) to (n,).

    Args:
        achieved: Where end-effector, or block, is after the step [m].
        desired: Goal to judge it by [m].
        costs: The step's ``d_mm``, ``d_mp`` and ``base_jerk_rms``, and where there is a
            block ``failed`` and ``held``.
        config: The task.
    """
    distance = goal_distance(achieved, desired)
    terms = costs["d_mm"], costs["d_mp"], costs["base_jerk_rms"]
    failed = np.asarray(costs.get("failed", False)).astype(bool)
    held = np.asarray(costs.get("held", True)).astype(bool)
    reward = reach_reward(distance, *terms, config, failed, held)
    return reward, reached(distance, config, held) | failed
