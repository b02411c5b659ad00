"""What offline algorithms learn from: goals, shares, masks, streams."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from marl_mm.algorithms.offline_batches import OfflineBatch, OfflineBatches
from marl_mm.algorithms.replay import DRAWN_TOGETHER
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of, joined
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT, Reach
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError, UsageError

TASK = make_task()
assert isinstance(TASK, Reach)

LENGTHS = [3 + i % 5 for i in range(12)]


@pytest.fixture(scope="module")
def arrays(make_episode: Callable[..., Episode]) -> EpisodeArrays:
    """Twelve episodes, every third of which fails; states and rewards are unique."""
    episodes = [make_episode(i, LENGTHS[i], i % 3 > 0) for i in range(len(LENGTHS))]
    return arrays_of(episodes, "x")


def drawn(
    arrays: EpisodeArrays, future: float, elsewhere: float = 0.0, seed: int = 0
) -> OfflineBatch:
    """Some thousand transitions of one seed, as one batch."""
    batches = OfflineBatches(arrays, 100, (future, elsewhere), TASK, [seed])
    many = [batches.next() for _ in range(DRAWN_TOGETHER)]
    return OfflineBatch(
        *(torch.cat(parts, dim=1)[0] for parts in zip(*many, strict=True))
    )


def rows_of(arrays: EpisodeArrays, batch: OfflineBatch) -> np.ndarray:
    """Step of the dataset that each transition is of, by its action."""
    low, high = np.array(LAYOUT.low), np.array(LAYOUT.high)
    scaled = (2 * (arrays.actions - low) / (high - low) - 1).astype(np.float32)
    known = {row.tobytes(): number for number, row in enumerate(scaled)}
    return np.array([known[row.numpy().tobytes()] for row in batch.action])


def after(arrays: EpisodeArrays) -> np.ndarray:
    return np.asarray(arrays.states[~arrays.is_first_state()])


def test_goals_of_hindsight_are_all_later_steps_and_no_other(
    arrays: EpisodeArrays,
) -> None:
    """From each step every place its episode came to after it, the last one too."""
    batch = drawn(arrays, future=1.0)
    places = after(arrays)[:, LAYOUT.achieved].astype(np.float32)
    number = {place.tobytes(): row for row, place in enumerate(places)}
    goals = batch.observation[:, LAYOUT.goal].numpy()
    seen = {
        (row, number[goal.tobytes()])
        for row, goal in zip(rows_of(arrays, batch), goals, strict=True)
    }
    ends = np.cumsum(arrays.lengths)
    episode = arrays.step_episode()
    expected = {
        (row, later)
        for row in range(arrays.steps)
        for later in range(row, ends[episode[row]])
    }
    assert seen == expected


def test_both_observations_have_the_same_goal(arrays: EpisodeArrays) -> None:
    batch = drawn(arrays, future=0.4, elsewhere=0.4)
    before, behind = batch.observation, batch.next_observation
    assert torch.equal(before[:, LAYOUT.goal], behind[:, LAYOUT.goal])
    rows = rows_of(arrays, batch)
    rest = torch.from_numpy(after(arrays)[rows].astype(np.float32))
    assert torch.equal(behind[:, LAYOUT.observation], rest[:, LAYOUT.observation])


def test_the_next_action_is_of_the_same_episode(arrays: EpisodeArrays) -> None:
    """Of its last step there is none, and its own stands there."""
    batch = drawn(arrays, future=0.4, elsewhere=0.4)
    rows = rows_of(arrays, batch)
    episode, last = arrays.step_episode()[rows], np.cumsum(arrays.lengths) - 1
    ends = rows == last[episode]
    found = rows_of(arrays, batch._replace(action=batch.next_action))
    np.testing.assert_array_equal(found, np.where(ends, rows, rows + 1))
    assert 0 < ends.mean() < 1


@pytest.mark.parametrize(("future", "elsewhere"), [(0.2, 0.4), (0.0, 1.0), (0.5, 0.0)])
def test_shares_are_as_asked(
    arrays: EpisodeArrays, future: float, elsewhere: float
) -> None:
    batch = drawn(arrays, future, elsewhere)
    assert 1 - batch.imitated.mean().item() == pytest.approx(elsewhere, abs=0.03)
    rows = rows_of(arrays, batch)
    own = arrays.states[~arrays.is_last_state()][rows][:, LAYOUT.goal]
    changed = (batch.observation[:, LAYOUT.goal].numpy() != own.astype(np.float32)).any(
        1
    )
    later = changed & (batch.imitated.numpy() == 1)
    assert later.mean() == pytest.approx(future, abs=0.03)


def test_goals_elsewhere_are_goals_of_steps(arrays: EpisodeArrays) -> None:
    """Each step's as often as another's."""
    batch = drawn(arrays, future=0.0, elsewhere=1.0)
    goals = batch.observation[:, LAYOUT.goal].numpy()
    _, counts = np.unique(goals[:, 0], return_counts=True)
    of_steps = arrays.states[~arrays.is_last_state()][:, LAYOUT.goal][:, 0]
    values, steps = np.unique(of_steps.astype(np.float32), return_counts=True)
    assert len(counts) == len(values)
    np.testing.assert_allclose(counts / counts.sum(), steps / steps.sum(), atol=0.03)


def test_goals_elsewhere_have_nothing_to_do_with_the_step(
    arrays: EpisodeArrays,
) -> None:
    """Every episode's steps get every episode's goal, as often as chance has it."""
    states, owner = arrays.states.copy(), np.cumsum(arrays.is_first_state()) - 1
    states[:, LAYOUT.goal] = owner[:, None]
    batch = drawn(replace(arrays, states=states), future=0.0, elsewhere=1.0)
    counts = np.zeros((len(arrays), len(arrays)))
    goals = batch.observation[:, LAYOUT.goal][:, 0].numpy().astype(int)
    np.add.at(counts, (arrays.step_episode()[rows_of(arrays, batch)], goals), 1)
    expected = np.outer(arrays.lengths, arrays.lengths) / arrays.steps**2
    assert counts.all()
    np.testing.assert_allclose(counts / counts.sum(), expected, atol=0.006)


def test_rewards_of_other_goals_are_the_tasks_own(arrays: EpisodeArrays) -> None:
    batch = drawn(arrays, future=0.5, elsewhere=0.3)
    rows = rows_of(arrays, batch)
    terms = {k: v[rows] for k, v in arrays.reward_terms(TASK.needs).items()}
    achieved = after(arrays)[rows][:, LAYOUT.achieved]
    goals = batch.observation[:, LAYOUT.goal].numpy().astype(float)
    reward, ended = TASK.judge(achieved, goals, terms)
    own = arrays.states[~arrays.is_last_state()][rows][:, LAYOUT.goal]
    changed = (goals != own.astype(np.float32)).any(axis=1)
    np.testing.assert_allclose(batch.reward[changed], reward[changed], atol=1e-5)
    np.testing.assert_array_equal(batch.terminated[changed], ended[changed])
    kept = ~changed & (batch.imitated.numpy() == 1)  # elsewhere may be the same place
    own_rewards = arrays.rewards[rows][kept].astype(np.float32)
    np.testing.assert_array_equal(batch.reward[kept], own_rewards)
    assert changed.any() and kept.any()


def test_episodes_that_reached_their_goal_are_marked(arrays: EpisodeArrays) -> None:
    batch = drawn(arrays, future=0.3)
    good = arrays.successes()[arrays.step_episode()][rows_of(arrays, batch)]
    np.testing.assert_array_equal(batch.successful, good)
    assert 0 < good.mean() < 1


def test_each_seed_draws_from_a_stream_of_its_own(arrays: EpisodeArrays) -> None:
    """Whichever others there are, in whatever order."""

    def columns(seeds: list[int]) -> dict[int, list[torch.Tensor]]:
        batches = OfflineBatches(arrays, 8, (0.3, 0.3), TASK, seeds, extra=2)
        first = batches.next()
        return {seed: [c[i] for c in first] for i, seed in enumerate(seeds)}

    alone = {seed: columns([seed])[seed] for seed in (3, 4, 7)}
    for seeds in ([3, 4, 7], [7, 3]):
        for seed, parts in columns(seeds).items():
            assert all(
                torch.equal(a, b) for a, b in zip(parts, alone[seed], strict=True)
            )
    for mine, others in ((3, 4), (4, 7)):
        assert not torch.equal(alone[mine][0], alone[others][0])
        assert not torch.equal(alone[mine][-1], alone[others][-1])  # the noise


def test_chunks_are_steps_in_a_row(arrays: EpisodeArrays) -> None:
    """By loops, for all steps: those at an episode's end, too, whether it is final."""
    truncated = replace(arrays, terminated=arrays.terminated & False)
    for data in (arrays, truncated):
        batches = OfflineBatches(data, 100, (0, 0), TASK, [0], chunk=4, discount=0.5)
        batch = OfflineBatch(*(column[0] for column in batches.next()))
        first = data.states[~data.is_last_state()].astype(np.float32)
        known = {row.tobytes(): number for number, row in enumerate(first)}
        low, high = np.array(LAYOUT.low), np.array(LAYOUT.high)
        scaled = (2 * (data.actions - low) / (high - low) - 1).astype(np.float32)
        episode, lengths = data.step_episode(), set()
        for number, state in enumerate(batch.observation):
            row = known[state.numpy().tobytes()]
            steps = [r for r in range(row, row + 4) if r < len(episode)]
            steps = [r for r in steps if episode[r] == episode[row]]
            lengths.add(len(steps))
            repeated = steps + [steps[-1]] * (4 - len(steps))
            action = batch.action[number].numpy().reshape(4, -1)
            np.testing.assert_array_equal(action, scaled[repeated])
            total = sum(0.5**i * data.rewards[r] for i, r in enumerate(steps))
            assert batch.reward[number].item() == pytest.approx(total, rel=1e-6)
            behind = after(data)[steps[-1]].astype(np.float32)
            assert np.array_equal(batch.next_observation[number].numpy(), behind)
            assert batch.terminated[number] == data.terminated[steps[-1]]
            assert batch.discount[number] == 0.5 ** len(steps)
            within = [1.0] * len(steps) + [0.0] * (4 - len(steps))
            assert batch.within[number].tolist() == within
        assert lengths == {1, 2, 3, 4}
        assert batch.noise.shape == (100, 4 * len(LAYOUT.action))


def test_chunks_of_several_steps_keep_their_goals(arrays: EpisodeArrays) -> None:
    for shares in ((0.1, 0.0), (0.0, 0.1)):
        with pytest.raises(UsageError, match="chunks of 2 steps with other goals"):
            OfflineBatches(arrays, 4, shares, TASK, [0], chunk=2)


def test_noise_is_standard_normal(arrays: EpisodeArrays) -> None:
    noise = drawn(arrays, 0.0).noise
    assert noise.shape == (4000, 4) and noise.dtype == torch.float32
    assert noise.mean(0).abs().max() < 0.06 and (noise.std(0) - 1).abs().max() < 0.05


@pytest.mark.parametrize("taken", [0, 1, DRAWN_TOGETHER - 1, DRAWN_TOGETHER, 95])
def test_streams_go_on_where_they_stood(arrays: EpisodeArrays, taken: int) -> None:
    one = OfflineBatches(arrays, 4, (0.3, 0.3), TASK, [0, 1])
    for _ in range(taken):
        one.next()
    other = OfflineBatches(arrays, 4, (0.3, 0.3), TASK, [8, 9])
    other.next()  # it had begun something else
    other.load_states([one.state(number) for number in range(2)])
    assert [other.state(n) for n in range(2)] == [one.state(n) for n in range(2)]
    for _ in range(DRAWN_TOGETHER + 2):
        pairs = zip(one.next(), other.next(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)


def test_some_of_the_data_is_always_the_same(arrays: EpisodeArrays) -> None:
    one, other = (OfflineBatches(arrays, 4, (0.5, 0.5), TASK, [s]) for s in (0, 1))
    for a, b in zip(one.some(7), other.some(7), strict=True):
        assert torch.equal(a, b) and a.shape[:2] == (1, 7)
    assert one.some(10**6)[0].shape[1] == len(one) == arrays.steps


def test_what_is_not_told_forbids_other_goals_only(arrays: EpisodeArrays) -> None:
    unknown = {**arrays.info, "d_mp": np.full(arrays.steps, np.nan)}
    imported = replace(arrays, info=unknown)
    OfflineBatches(imported, 4, (0.0, 0.0), TASK, [0]).next()
    for shares in ((0.1, 0.0), (0.0, 0.1)):
        with pytest.raises(UsageError, match="lacks d_mm, d_mp, base_jerk_rms"):
            OfflineBatches(imported, 4, shares, TASK, [0])


@pytest.mark.parametrize("name", ["states", "actions", "rewards"])
def test_what_is_not_finite_is_named(arrays: EpisodeArrays, name: str) -> None:
    values = getattr(arrays, name).copy()
    values[5] = np.nan
    with pytest.raises(
        DatasetError, match=rf"{name} are not finite, the first in row 5"
    ):
        OfflineBatches(replace(arrays, **{name: values}), 4, (0, 0), TASK, [0])


def test_the_goal_may_stand_anywhere(arrays: EpisodeArrays) -> None:
    """With columns in another order, batches are the same but for that order."""
    order = [8, 3, 0, 7, 5, 1, 9, 2, 4, 6]
    state = tuple(LAYOUT.state[i] for i in order)
    turned = replace(
        arrays, states=arrays.states[:, order], layout=replace(LAYOUT, state=state)
    )
    assert isinstance(turned.layout.goal, list)
    one, other = drawn(arrays, 0.3, 0.3), drawn(turned, 0.3, 0.3)
    assert torch.equal(one.observation[:, order], other.observation)
    assert torch.equal(one.next_observation[:, order], other.next_observation)
    assert torch.equal(one.reward, other.reward)
    assert torch.equal(one.terminated, other.terminated)


@pytest.mark.parametrize("discount", [0.0, 0.5])
def test_the_rest_of_an_episode_is_its_return_unless_it_was_cut_off(
    arrays: EpisodeArrays, discount: float
) -> None:
    batches = OfflineBatches(arrays, 400, (0, 0), TASK, [0], discount=discount)
    batch = OfflineBatch(*(part[0] for part in batches.next()))
    ends = np.cumsum(arrays.lengths)
    for row, rest in zip(rows_of(arrays, batch), batch.rest, strict=True):
        end = ends[np.searchsorted(ends, row, "right")]
        ahead = arrays.rewards[row:end]
        known = (ahead * discount ** np.arange(len(ahead))).sum()
        cut = arrays.truncated[end - 1]
        assert rest == (-np.inf if cut else pytest.approx(known, rel=1e-5))


@pytest.mark.parametrize("kept", [0.2, 0.9])
def test_own_steps_come_in_the_ratio_that_is_asked_for(
    arrays: EpisodeArrays, make_episode: Callable[..., Episode], kept: float
) -> None:
    """Whatever their number; and each goes on as its own episode did."""
    own = [arrays_of([make_episode(50 + i, 2 + i)], "own") for i in range(3)]
    batches = OfflineBatches(arrays, 100, (0.0, 0.0), TASK, [0])
    for episodes in own:
        batches.add(episodes, kept)
    assert batches.own == (3, 2 + 3 + 4)
    every = joined([arrays, *own])
    many = [batches.next() for _ in range(DRAWN_TOGETHER)]
    batch = OfflineBatch(
        *(torch.cat(parts, dim=1)[0] for parts in zip(*many, strict=True))
    )
    rows = rows_of(every, batch)
    assert np.mean(rows < arrays.steps) == pytest.approx(kept, abs=0.03)
    last = (np.cumsum(every.lengths) - 1)[every.step_episode()[rows]]
    then = rows_of(every, batch._replace(action=batch.next_action))
    np.testing.assert_array_equal(then, np.minimum(rows + 1, last))
