"""Film a policy."""

import base64
import math
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from marl_mm.envs.demos import Drift, arm_reach, base_turn, demo_drive
from marl_mm.envs.drive import Tick
from marl_mm.envs.registry import DEFAULT, TASKS, make_task
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.eval.goals import goal_set
from marl_mm.eval.video import (
    Recorder,
    check_format,
    film_episode,
    film_strip,
    pictures_of,
    write_video,
)
from marl_mm.files import refuse_existing
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.evaluate import task_overrides
from marl_mm.runs.policies import load_policy, own_engine, own_task
from marl_mm.runs.settings import as_path, check_positive, check_seed
from marl_mm.sim.config import RATE, RECORDED_ENGINE, Camera, Engine

Direction = Literal["forward", "backward"]

_STRIP = 6
"""Pictures of a film strip."""


@dataclass(frozen=True, eq=False)
class Film:
    """A filmed episode."""

    episode: Episode
    """The episode."""

    frames: list[np.ndarray]
    """Pictures, each of shape (height, width, 3), uint8."""

    fps: int
    """Pictures per simulated second."""

    task: str
    """Registered name of the task."""

    policy: str
    """Name of the policy."""

    engine: Engine = RECORDED_ENGINE
    """Engine of the simulation."""

    def save(self, path: str | Path, overwrite: bool = False) -> None:
        """Write the film as mp4 or gif, by the name's ending.

        Raises:
            UsageError: If the ending is another, or the file exists.
        """
        self._check_drawn()
        file = as_path(path, "path", "a file")
        check_format(file)
        refuse_existing(file, overwrite, file=True)
        write_video(file, self.frames, self.fps)

    def strip(self, path: str | Path, overwrite: bool = False) -> None:
        """Write six pictures of the episode, side by side, as a PNG.

        Raises:
            UsageError: If the name does not end in .png, or the file exists.
        """
        self._check_drawn()
        file = as_path(path, "path", "a file")
        check_strip(file)
        refuse_existing(file, overwrite, file=True)
        label = f"{self.task}: {len(self.episode)} steps"
        per_step = self.fps * make_task(self.task).seconds_per_step
        film_strip(file, [(label, pictures_of(self.frames, per_step, _STRIP))])

    def _check_drawn(self) -> None:
        if not self.frames:
            raise UsageError(f"{self!r} has no pictures: play without `gui=True`")

    def __repr__(self) -> str:
        ending = "reached" if self.episode.success else "did not reach"
        steps = len(self.episode)
        where = f"{steps} steps on {self.engine}"
        return f"<Film: {self.policy} {ending} the goal in {where}>"

    def _repr_html_(self) -> str:
        """The film itself, for notebooks."""
        if not self.frames:
            return escape(repr(self))
        with TemporaryDirectory() as folder:
            path = Path(folder, "film.mp4")
            write_video(path, self.frames, self.fps)
            data = base64.b64encode(path.read_bytes()).decode()
        return f'<video controls loop src="data:video/mp4;base64,{data}"></video>'


@dataclass(frozen=True)
class View:
    """Settings of a camera that take the place of a task's; None leaves its own."""

    width: int | None = None
    """Width of the image [pixels]; a multiple of 16 suits video codecs."""

    height: int | None = None
    """Height of the image [pixels]."""

    target_w: tuple[float, float, float] | None = None
    """Point at the centre of the image [m]."""

    distance: float | None = None
    """Distance from the target [m]."""

    yaw: float | None = None
    """Yaw of the view [deg]."""

    pitch: float | None = None
    """Pitch of the view [deg]."""

    def of(self, camera: Camera) -> Camera:
        """A camera with these settings."""
        asked = {name: value for name, value in vars(self).items() if value is not None}
        return replace(camera, **asked)


def default_policy(task: str) -> str:
    """Name of the policy that plays a task if none is named: its script, or pd.

    Args:
        task: Registered name of the task.
    """
    own = type(TASKS.get(task)).expert is not Task.expert
    return "scripted" if own else "pd"


def play(
    policy: Any = None,
    *,
    task: str | None = None,
    seed: int = 0,
    direction: Direction | None = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    fps: int = 10,
    gui: bool = False,
    camera: Camera | None = None,
    config: Any = None,
    progress: Bar = silent_bar,
    **settings: Any,
) -> Film:
    """Film an episode of a policy.

    Args:
        policy: Run, run folder, checkpoint file, ``pretrained``, a collector's name, or
            a policy; default the task's script, or pd where it has none.
        task: Registered name of the task; default the run's own, or Reach-v0.
        seed: Seed of the goal and of random policies.
        direction: Side of the robot on which the goal is, where the task does not draw
            its own; default backward.
        max_steps: Steps of one second until the episode is cut off; default the task's.
        engine: Engine of the simulation, bullet or mujoco; default the run's own.
        fps: Pictures per second of film and of simulated time.
        gui: Open PyBullet's window and take no pictures; needs a screen.
        camera: Place of the camera; default the task's.
        config: Settings of a collector's policy; default the collector's.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.
        **settings: Settings of a collector's policy, by name.

    Raises:
        UsageError: If a setting makes no sense, or there is no such policy.
        CheckpointError: If a run's checkpoint is damaged.
    """
    _check_fps(fps)
    check_seed(seed)
    if direction not in (None, "forward", "backward"):
        raise UsageError(
            f"`direction` is {direction!r:.40}, expected forward, backward or None"
        )
    if not isinstance(camera, Camera | None):
        raise UsageError(f"`camera` is {camera!r:.40}, expected a Camera or None")
    name = task or (DEFAULT if policy is None else own_task([policy]))
    policy = default_policy(name) if policy is None else policy
    overrides = task_overrides(max_steps, engine or own_engine([policy]))
    variant = make_task(name, overrides)
    actor = load_policy(policy, variant, config, **settings)
    ahead, behind = goal_set(variant, 2, seed)
    if direction is not None and ahead.goal is None:
        raise UsageError(f"`direction` is not for {name}: its seed draws the goal")
    episode, frames = film_episode(
        variant,
        actor,
        ahead if direction == "forward" else behind,
        camera or variant.camera,
        0 if gui else fps,
        gui,
        progress(f"play {actor.name}", variant.max_steps),
    )
    return Film(episode, frames, fps, name, actor.name, variant.simulation.engine)


@dataclass(frozen=True)
class Motion:
    """Motion of one half of the robot while the other rests; see ``envs.demos``."""

    target: tuple[float, float, float] = (0.8, 0.3, 0.8)
    """Place that the hand reaches in "arm-reach", world x, y, z [m]; it starts at
    0.65, 0.10, 0.58."""

    angle: float = 90.0
    """Angle by which the base turns in "base-turn", -180 to 180 [deg]."""

    seconds: float = 4.0
    """Duration of "arm-reach" and "base-turn", 0.1 to 60 [s]."""

    def __post_init__(self) -> None:
        """Refuse a motion that makes no sense."""
        if not 0.1 <= self.seconds <= 60:
            raise UsageError(f"`seconds` is {self.seconds}, expected 0.1 to 60")
        if not -180 <= self.angle <= 180:
            raise UsageError(f"`angle` is {self.angle}, expected -180 to 180 degrees")
        if not all(map(math.isfinite, self.target)):
            raise UsageError(f"`target` is {self.target}, expected finite numbers [m]")


def play_demo(
    name: str,
    motion: Motion,
    *,
    fps: int = 10,
    gui: bool = False,
    camera: Camera | None = None,
    progress: Bar = silent_bar,
) -> tuple[Drift, list[np.ndarray]]:
    """Film one half of the robot at work while the other rests.

    Args:
        name: ``arm-reach`` or ``base-turn``.
        motion: Motion of the demo.
        fps: Pictures per second of film and of simulated time.
        gui: Open PyBullet's window and take no pictures.
        camera: Place of the camera.
        progress: Factory of progress bars, see ``marl_mm.progress.Bar``.

    Returns:
        How far the resting half drifted, and the pictures.

    Raises:
        UsageError: If a setting makes no sense.
    """
    _check_fps(fps)
    drive = demo_drive(visual=True, gui=gui)
    film = Recorder(drive.world, camera or Camera(), 0 if gui else fps)
    advance = progress(f"play {name}", round(motion.seconds * RATE))

    def watch(tick: Tick) -> None:
        film(tick)
        advance(1, "")

    try:
        if name == "arm-reach":
            drift = arm_reach(drive, np.array(motion.target), motion.seconds, watch)
        else:
            drift = base_turn(drive, math.radians(motion.angle), motion.seconds, watch)
        film.add()
    finally:
        drive.close()
    return drift, film.frames


def check_strip(path: Path) -> None:
    """Raise a UsageError if a film strip's name has another ending than .png."""
    if path.suffix != ".png":
        raise UsageError(f"film strip {path} ends in {path.suffix!r}, expected .png")


def _check_fps(fps: int) -> None:
    check_positive(fps=fps)
    if fps > RATE:
        raise UsageError(f"`fps` is {fps}, expected at most {RATE}, a picture a tick")
