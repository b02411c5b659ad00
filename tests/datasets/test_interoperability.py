"""Other people's libraries read our datasets as they are."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import minari
import numpy as np
import pytest
import stable_baselines3

from marl_mm.datasets import shipped
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED, locate
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.errors import UsageError


@pytest.fixture
def good(datasets_home: Path) -> Iterator[Dataset]:
    """The dataset that ships, unpacked by its first use."""
    assert not locate(SHIPPED).folder.exists()
    yield load_dataset("good-5k")


def test_what_ships_is_small_whole_and_good(good: Dataset) -> None:
    assert shipped.arrays_file().stat().st_size < 3e6
    assert sum(shipped.arrays_file(name).stat().st_size for name in shipped.IDS) < 8e6
    arrays = good.arrays
    assert arrays.steps >= 5_000 > arrays.steps - arrays.lengths[-1]
    assert arrays.successes().all()
    assert good.metadata["marl_mm"]["collector"] == "pretrained"
    assert load_dataset(SHIPPED).fingerprint == good.fingerprint


@pytest.mark.slow
def test_several_processes_may_use_it_first(datasets_home: Path) -> None:
    code = (
        "from marl_mm.datasets import load_dataset;"
        "print(load_dataset('good-5k').fingerprint)"
    )
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        for _ in range(3)
    ]
    prints = {process.communicate()[0] for process in processes}
    assert {process.returncode for process in processes} == {0} and len(prints) == 1
    folder = locate(SHIPPED).folder
    assert [path for path in folder.parent.iterdir() if path.is_dir()] == [folder]


@pytest.mark.slow
def test_minari_gives_episodes_and_the_environment_back(good: Dataset) -> None:
    dataset = minari.load_dataset(SHIPPED)
    assert dataset.total_steps == good.arrays.steps
    env = dataset.recover_environment()
    episode = next(iter(dataset.iterate_episodes()))
    seed = next(iter(dataset.storage.get_episode_metadata([episode.id])))["seed"]
    observation, _ = env.reset(seed=seed)
    for t, action in enumerate(episode.actions):
        for key, values in episode.observations.items():
            np.testing.assert_array_equal(observation[key], values[t])
        observation, reward, terminated, truncated, _ = env.step(action)
        assert reward == episode.rewards[t]
        assert terminated == episode.terminations[t]
        assert truncated == episode.truncations[t]
    env.close()


@pytest.mark.slow
def test_torchrl_samples_from_it(good: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("torchrl")
    from torchrl.data.datasets import MinariExperienceReplay

    few = arrays_of([good.arrays.episode(number) for number in range(30)], SHIPPED)
    write_dataset(locate("marl_mm/reach/few-v0"), few, good.provenance)
    replay = MinariExperienceReplay(
        "marl_mm/reach/few-v0",
        batch_size=256,
        root=tmp_path / "torchrl",
        download=False,
        load_from_local_minari=True,
    )
    assert len(replay) == few.steps
    batch = replay.sample()
    seen = batch["observation", "observation"].numpy()
    assert seen.shape == (256, 7)
    known = {row.tobytes() for row in good.joint().observation[: few.steps, :7]}
    assert {row.tobytes() for row in seen} <= known


@pytest.mark.slow
def test_stable_baselines3_is_told_to_keep_infos() -> None:
    """Its replay drops them by default, and rewards depend on them."""
    env = GoalEnv(overrides={"ticks_per_step": 24, "max_steps": 4})
    model = stable_baselines3.DDPG(
        "MultiInputPolicy",
        env,
        replay_buffer_class=stable_baselines3.HerReplayBuffer,
        learning_starts=4,
        batch_size=8,
    )
    with pytest.raises(UsageError, match="copy_info_dict=True"):
        model.learn(12)
    env.close()
