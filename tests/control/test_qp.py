"""The reference QP solvers: equal bytes, equal answers, honest about failure."""

import subprocess
import sys

import numpy as np
import pytest

from marl_mm.control.reference.qp import SolveQp, daqp, proxqp

EPISODE = """
import hashlib, numpy as np
from marl_mm.envs.registry import make_task
from marl_mm.envs.core import EpisodeCore
overrides = {"controller": {"solver": "proxqp"}, "ticks_per_step": 120}
core = EpisodeCore(make_task("Reach-v0", overrides))
for _ in range(2):
    core.reset(np.random.default_rng(0), np.array([-0.6, 0.1, 0.6]))
    for _ in range(4):
        state = core.step(np.array([-1.0, 0.2, 0.1, 0.5])).state
    print(hashlib.sha256(state.tobytes()).hexdigest())
"""


def random_problem(
    rng: np.random.Generator, room: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    root = rng.normal(size=(9, 9))
    hessian = root.T @ root + 1e-3 * np.eye(9)
    half = rng.uniform(0.1, 1.0, 17) * room
    return hessian, rng.normal(size=9), rng.normal(size=(17, 9)), -half, half


def test_bytes_do_not_hang_on_where_malloc_puts_things() -> None:
    """Equal problems have equal solutions, whatever else lies on the heap."""
    rng = np.random.default_rng(0)
    kept = []
    for _ in range(20):
        problem = random_problem(rng, 0.1)
        found = set()
        for _ in range(20):
            kept += [bytearray(int(size)) for size in rng.integers(16, 6000, 20)]
            x = proxqp(*problem)
            assert not isinstance(x, int)
            found.add(x.tobytes())
        assert len(found) == 1


@pytest.mark.slow
def test_an_episode_with_proxqp_repeats_to_the_byte() -> None:
    """Twice in one process, and in a second one with another heap."""
    outputs = [
        subprocess.run(
            [sys.executable, "-c", kept + EPISODE],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for kept in ("", "kept = [bytearray(i * 37) for i in range(999)]\n")
    ]
    assert len(set(outputs[0] + outputs[1])) == 1


def test_both_solvers_agree() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        problem = random_problem(rng, 0.3)
        np.testing.assert_allclose(proxqp(*problem), daqp(*problem), atol=1e-6)


@pytest.mark.parametrize("solve", [proxqp, daqp])
def test_a_contradiction_is_blamed_on_a_row(solve: SolveQp) -> None:
    matrix = np.zeros((3, 9))
    matrix[0, 0] = matrix[1, 0] = matrix[2, 5] = 1.0
    lower, upper = np.array([1.0, -5.0, -1.0]), np.array([5.0, -1.0, 1.0])
    row = solve(np.eye(9), np.zeros(9), matrix, lower, upper)
    assert row in (0, 1)
