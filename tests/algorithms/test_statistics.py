"""Mean and deviation of a stream are those of all of it at once."""

import numpy as np
import pytest

from marl_mm.algorithms.statistics import RunningStatistics


def test_pieces_of_any_size_give_what_the_whole_gives() -> None:
    rng = np.random.default_rng(0)
    offset = np.array([1e6, 0.0, -5.0])  # where sums of squares lose all digits
    stream = offset + rng.normal(size=(500, 3)) * [1.0, 3.0, 0.1]
    statistics = RunningStatistics(3, floor=1e-3)
    for piece in np.split(stream, [1, 2, 40, 41, 300]):
        statistics.add(piece)
    np.testing.assert_allclose(statistics.mean, stream.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(statistics.std, stream.std(axis=0), rtol=1e-6)


def test_what_never_varies_keeps_the_floor() -> None:
    statistics = RunningStatistics(2, floor=0.01)
    assert statistics.std.tolist() == [1.0, 1.0]  # nothing seen yet
    statistics.add(np.array([[4.0, 1.0], [4.0, 3.0]]))
    assert statistics.std.tolist() == pytest.approx([0.01, 1.0])


def test_a_restored_stream_goes_on_and_the_state_does_not() -> None:
    one, other = RunningStatistics(2, 0.01), RunningStatistics(2, 0.01)
    rng = np.random.default_rng(1)
    one.add(rng.normal(size=(7, 2)))
    state = one.state()
    other.load_state(state)
    more = rng.normal(size=(5, 2))
    one.add(more)
    other.add(more)
    assert one.state()["count"] == other.state()["count"] == 12
    for name in ("mean", "squares"):
        assert one.state()[name].equal(other.state()[name])
        assert not one.state()[name].equal(state[name])
