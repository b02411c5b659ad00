"""Pictures of the environments, and films that Gymnasium records of them."""

from contextlib import closing
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
from marl_mm.errors import UsageError

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]


@pytest.mark.parametrize("task", REACHING)
def test_render_shows_the_robot(task: str) -> None:
    """Nothing else moves."""
    env = GoalEnv(task, render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert image is not None
    assert image.shape == (320, 480, 3)
    env.step(np.ones(env.action_space.shape or ()))
    later = env.render()
    assert later is not None
    moved = (later != image).any(axis=2)
    assert moved.mean() > 0.02
    env.close()


def test_who_is_filmed_moves_as_otherwise() -> None:
    """A block's contacts come in the order of the bodies, the drawn ones among them."""
    states = []
    for mode in (None, "rgb_array"):
        with closing(parallel_env("CarryReach-v0", render_mode=mode)) as env:
            env.reset(seed=0)
            env.step({a: env.action_space(a).high for a in env.agents})
            states.append(env.state().tobytes())
    assert states[0] == states[1]


def test_there_is_no_picture_before_an_episode() -> None:
    for engine in ("bullet", "mujoco"):
        overrides = {"simulation": {"engine": engine}}
        with closing(GoalEnv("Reach-v0", overrides, render_mode="rgb_array")) as env:
            with pytest.raises(UsageError, match=r"render\(\) was called before reset"):
                env.render()


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
