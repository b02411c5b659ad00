"""Videos and film strips of an episode, from PyBullet's CPU renderer."""

import math
import os
import signal
import subprocess
from collections.abc import Collection, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import imageio_ffmpeg
import numpy as np
from matplotlib.figure import Figure

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Tick
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.goals import goal_set
from marl_mm.files import new_file
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent
from marl_mm.sim.config import RATE, Camera

FORMATS = (".mp4", ".gif")

WAYS = "forward", "backward"
"""Directions of the first two goals of a seed."""

Strips = Sequence[tuple[str, Sequence[tuple[str, np.ndarray]]]]
"""Rows of a film strip: a label, and pairs of a note and its picture."""


def check_format(path: Path) -> None:
    """Raise if a video's name has an unknown ending.

    Raises:
        UsageError: If it is neither mp4 nor gif.
    """
    if path.suffix not in FORMATS:
        raise UsageError(
            f"video {path} ends in {path.suffix!r}, expected {' or '.join(FORMATS)}"
        )


class Rendered(Protocol):
    """Something to film: a world, or several side by side."""

    def render(self, camera: Camera) -> np.ndarray:
        """A picture, shape (height, width, 3), uint8."""


class Recorder:
    """Frames of a world, taken tick by tick at a rate of simulated time.

    Args:
        world: World to film.
        camera: Place of the camera.
        fps: Frames per simulated second; 0 takes none.
        wanted: Numbers of the frames to take; None takes all.
    """

    def __init__(
        self,
        world: Rendered,
        camera: Camera,
        fps: int,
        wanted: Collection[int] | None = None,
    ) -> None:
        self._world, self._camera, self._fps = world, camera, fps
        self._elapsed = self._number = 0
        self._wanted = wanted
        self.frames: list[np.ndarray] = []
        """Frames, each of shape (height, width, 3), uint8."""

    def __call__(self, tick: Tick) -> None:
        """Take a frame if it is time for the next after this tick."""
        self._elapsed += tick.robot == 0
        if self._elapsed * self._fps > self._number * RATE:
            self.add()

    def add(self) -> None:
        """Take the next frame now, whatever the time."""
        if self._fps and (self._wanted is None or self._number in self._wanted):
            self.frames.append(self._world.render(self._camera))
        self._number += 1


def film_episode(
    config: Task,
    policy: Policy,
    plan: EpisodePlan,
    camera: Camera,
    fps: int,
    gui: bool = False,
    advance: Advance = silent,
    wanted: Collection[int] | None = None,
) -> tuple[Episode, list[np.ndarray]]:
    """Run an episode and render it.

    Args:
        config: Task of the episode.
        policy: Policy that acts.
        plan: Seed and goal of the episode.
        camera: Place of the camera.
        fps: Frames per simulated second; 0 renders nothing, for watching the window.
        gui: Whether to open PyBullet's window.
        advance: Called with the number of finished steps.
        wanted: Numbers of the frames to render; None renders all.

    Returns:
        The episode, and frames of shape (height, width, 3), uint8.
    """
    core = EpisodeCore(config, visual=True, gui=gui)
    film = Recorder(core, camera, fps, wanted)

    def watch(tick: Tick) -> None:
        film(tick)
        if (tick.number, tick.robot) == (config.ticks_per_step - 1, 0):
            advance(1, "")

    try:
        episode = run_episode(core, policy, plan, watch)
        film.add()
        return episode, film.frames
    finally:
        core.close()


class TwoWays(NamedTuple):
    """An episode ahead and one behind, filmed."""

    episodes: list[Episode]
    """The episode ahead and the one behind."""

    frames: list[np.ndarray]
    """Frames of both episodes, one after the other."""

    strips: list[tuple[str, list[tuple[str, np.ndarray]]]]
    """Rows for ``film_strip``: five pictures an episode, with the step in a corner."""


def film_both_ways(
    config: Task, policy: Policy, seed: int, fps: int, advance: Advance = silent
) -> TwoWays:
    """Film a policy on a seed's first goal ahead and on its first one behind.

    Args:
        config: Task of the episode.
        policy: Policy that acts.
        seed: Seed of the goals.
        fps: Frames per simulated second.
        advance: Called with the number of finished steps; both episodes together count
            twice the task's most.
    """
    result = TwoWays([], [], [])
    for number, plan in enumerate(goal_set(config, 2, seed)):
        episode, frames = film_episode(
            config, policy, plan, config.camera, fps, advance=advance
        )
        advance(config.max_steps - len(episode), "")
        result.episodes.append(episode)
        result.frames.extend(frames)
        label = f"{_way(episode, number)}: {len(episode)} steps"
        per_step = fps * config.seconds_per_step
        result.strips.append((label, pictures_of(frames, per_step)))
    return result


def _way(episode: Episode, number: int) -> str:
    """Direction of an episode's goal, or its number where goals have none."""
    return episode.direction or f"goal {number}"


def pictures_of(
    frames: Sequence[np.ndarray], per_step: float, count: int = 5
) -> list[tuple[str, np.ndarray]]:
    """Pictures of an episode at even times, with their steps, for ``film_strip``.

    Args:
        frames: Frames of the episode.
        per_step: Number of frames in a step.
        count: Number of pictures.
    """
    numbers = _evenly(len(frames) - 1, count)
    return [(f"step {int(i / per_step + 1e-9)}", frames[i]) for i in numbers]


def _evenly(last: int, count: int) -> list[int]:
    """Numbers of frames at even times, from 0 to the last."""
    return [round(i * last / (count - 1)) for i in range(count)]


def strips_both_ways(config: Task, policy: Policy, seed: int) -> Strips:
    """The strips of ``film_both_ways`` at a frame a second, without its other frames.

    Args:
        config: Task of the episode.
        policy: Policy that acts.
        seed: Seed of the goals.
    """
    strips = []
    for number, plan in enumerate(goal_set(config, 2, seed)):
        with closing(EpisodeCore(config)) as core:
            # Watched as below: the compiled loop may end a step sooner or later.
            episode = run_episode(core, policy, plan, lambda tick: None)
        steps = len(episode)
        wanted = _evenly(math.ceil(steps * config.ticks_per_step / RATE), 5)
        _, frames = film_episode(config, policy, plan, config.camera, 1, wanted=wanted)
        taken = dict(zip(sorted({*wanted}), frames, strict=True))
        length = config.seconds_per_step
        numbers = [min(steps, int(n / length + 1e-9)) for n in wanted]
        pictures = [
            (f"step {i}", taken[n]) for i, n in zip(numbers, wanted, strict=True)
        ]
        strips.append((f"{_way(episode, number)}: {steps} steps", pictures))
    return strips


def write_video(path: Path, frames: Sequence[np.ndarray], fps: int) -> None:
    """Write frames as mp4 (H.264) or gif; the file appears whole or not at all.

    Raises:
        UsageError: If the ending is neither.
        MarlMmError: If ffmpeg fails, as on a full disk.
    """
    check_format(path)
    height, width, _ = frames[0].shape
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    made = ["-pix_fmt", "yuv420p", "-crf", "25"]
    if path.suffix == ".gif":
        made = ["-pix_fmt", "rgb8"]
    if width % 2 or height % 2:  # H.264 halves the resolution of colors
        made += ["-vf", f"scale={width + width % 2}:{height + height % 2}"]
    program = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error"]
    with new_file(path) as temporary:
        words = [*program, *given, "-r", str(fps), "-i", "-", *made, str(temporary)]
        if problem := _encoded(words, frames):
            raise MarlMmError(f"cannot write {path}: {problem}")


def _encoded(command: Sequence[str], frames: Sequence[np.ndarray]) -> str:
    """Give frames to an ffmpeg; return why it failed, or nothing."""
    with os.fdopen(os.memfd_create("errors"), "w+") as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            process_group=0,  # Ctrl-C is for us
        )
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError), process.stdin as pipe:
                for frame in frames:
                    pipe.write(np.ascontiguousarray(frame).data)
        except BaseException:
            process.kill()
            raise
        finally:
            code = process.wait()
        if code < 0:
            return f"ffmpeg was ended: {signal.strsignal(-code)}"
        errors.seek(0)
        lines = errors.read().splitlines() if code else []
    if code:
        return lines[-1].rpartition(": ")[-1] if lines else f"ffmpeg ended with {code}"
    return ""


def film_strip(path: Path, rows: Strips) -> None:
    """Write pictures side by side, one row per episode, as a PNG.

    Args:
        path: File of the PNG.
        rows: Labels of rows with their pictures, each with a note for its corner.
    """
    with new_file(path) as temporary:
        draw_film_strip(temporary, rows)


def draw_film_strip(file: Path | IO[bytes], rows: Strips) -> None:
    """``film_strip`` into an open file, or a path."""
    columns = max(len(pictures) for _, pictures in rows)
    high, wide, _ = rows[0][1][0][1].shape
    size = 2.6 * (wide / high / 1.5) * columns, 2.0 * len(rows)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = figure.subplots(len(rows), columns, squeeze=False)
    for line, (label, pictures) in zip(axes, rows, strict=True):
        for axis in line:
            axis.set_axis_off()
        for axis, (note, picture) in zip(line, pictures, strict=False):
            axis.imshow(picture)
            axis.text(8, picture.shape[0] - 12, note, fontsize=8)
        line[0].set_title(label, loc="left", fontsize=9)
    figure.savefig(file, dpi=110)
