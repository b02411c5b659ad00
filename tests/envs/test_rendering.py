"""Pictures of the environments, and films that Gymnasium records of them."""

from pathlib import Path

import gymnasium
import imageio_ffmpeg
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import marl_mm  # noqa: F401  registers the environments
from marl_mm.envs import parallel_env
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.registry import TASKS
from marl_mm.envs.tasks.reach import Reach

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]


@pytest.mark.parametrize("task", REACHING)
def test_render_shows_the_robot(task: str) -> None:
    env = GoalEnv(task, render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert image is not None
    assert image.shape == (320, 480, 3)
    assert image.std() > 10  # not an empty picture
    env.close()


@pytest.mark.parametrize(("ticks", "fps"), [(240, 1.0), (24, 10.0)])
def test_films_run_at_the_speed_of_the_robot(ticks: int, fps: float) -> None:
    for make in (GoalEnv, parallel_env):
        env = make("Reach-v0", {"ticks_per_step": ticks})
        assert env.metadata["render_modes"] == ["rgb_array"]
        assert env.metadata["render_fps"] == fps
        env.close()


@pytest.mark.slow
def test_gymnasium_records_an_episode(tmp_path: Path) -> None:
    env = gymnasium.make(
        "marl_mm/Reach-v0", render_mode="rgb_array", overrides={"max_steps": 3}
    )
    folder = tmp_path / "films"
    recorder = RecordVideo(env, str(folder), episode_trigger=lambda number: True)
    recorder.reset(seed=0)
    pictures, over = [np.asarray(env.render())], False
    while not over:
        *_, terminated, truncated, _ = recorder.step(np.ones(4, np.float32))
        pictures.append(np.asarray(env.render()))
        over = terminated or truncated
    recorder.close()  # type: ignore[no-untyped-call]
    (film,) = folder.glob("*.mp4")
    reader = imageio_ffmpeg.read_frames(str(film))
    about = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(320, 480, 3) for frame in reader]
    assert about["size"] == (480, 320) and about["fps"] == 1.0
    assert len(frames) == len(pictures) == 4
    errors = [
        [
            np.abs(np.subtract(frame, picture, dtype=float)).mean()
            for picture in pictures
        ]
        for frame in frames
    ]
    assert np.argmin(errors, axis=1).tolist() == [0, 1, 2, 3]  # its own, in order
    assert np.diag(errors).max() < 5.0  # of 255: compression
