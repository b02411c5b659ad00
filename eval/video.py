"""Videos and film strips of an episode, from PyBullet's CPU renderer."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from matplotlib.figure import Figure

from marl_mm.envs.config import ReachConfig
from marl_mm.envs.core import ReachCore
from marl_mm.envs.rollout import EpisodePlan
from marl_mm.errors import UsageError
from marl_mm.files import new_file
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent
from marl_mm.sim.bullet import RATE, Camera

FORMATS = (".mp4", ".gif")


def check_format(path: Path) -> None:
    """Raise if a video's name has an unknown ending.

    Raises:
        UsageError: If it is neither mp4 nor gif.
    """
    if path.suffix not in FORMATS:
        raise UsageError(
            f"video {path} ends in {path.suffix!r}, expected one of {', '.join(FORMATS)}"
        )


def film_episode(
    config: ReachConfig,
    policy: Policy,
    plan: EpisodePlan,
    camera: Camera,
    fps: int,
    gui: bool = False,
    advance: Advance = silent,
) -> tuple[list[np.ndarray], bool]:
    """Run an episode and render it.

    Returns:
        Frames, each (height, width, 3) uint8, and whether the goal was reached.
    """
    core = ReachCore(config, visual=True, gui=gui)
    frames: list[np.ndarray] = []
    every = max(1, RATE // fps)

    def watch(tick: int) -> None:
        if tick % every == 0:
            frames.append(core.world.render(camera))

    try:
        rng = np.random.default_rng(plan.seed)
        goal = None if plan.goal_w is None else np.array(plan.goal_w)
        state = core.reset(rng, goal)
        policy.begin(np.random.default_rng([plan.seed, 1]))
        frames.append(core.world.render(camera))
        for _ in range(config.max_steps):
            step = core.step(policy.act(state), watch)
            state = step.state
            advance(1, f"{step.info['distance']:.2f} m to the goal")
            if step.terminated or step.truncated:
                break
        frames.append(core.world.render(camera))
        return frames, step.terminated
    finally:
        core.close()


def write_video(path: Path, frames: Sequence[np.ndarray], fps: int) -> None:
    """Write frames as mp4 (H.264) or gif; the file appears whole or not at all.

    Raises:
        UsageError: If the ending is neither.
    """
    check_format(path)
    height, width, _ = frames[0].shape
    with new_file(path) as temporary:
        codec = {"codec": "gif", "pix_fmt_out": "rgb8"} if path.suffix == ".gif" else {}
        writer = imageio_ffmpeg.write_frames(
            str(temporary), (width, height), fps=fps, macro_block_size=2, **codec
        )
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()


def film_strip(path: Path, rows: Sequence[tuple[str, Sequence[np.ndarray]]]) -> None:
    """Pictures side by side, one labelled row each, the step number in the corner."""
    columns = max(len(frames) for _, frames in rows)
    figure = Figure(figsize=(2.6 * columns, 1.9 * len(rows)), layout="constrained")
    axes: Any = figure.subplots(len(rows), columns, squeeze=False)
    for line, (label, frames) in zip(axes, rows, strict=True):
        for axis in line:
            axis.set_axis_off()
        for axis, frame in zip(line, frames, strict=False):
            axis.imshow(frame)
        line[0].set_title(label, loc="left", fontsize=9)
    with new_file(path) as temporary:
        figure.savefig(temporary, dpi=110)


Render = Callable[[], np.ndarray]
