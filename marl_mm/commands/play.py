"""marl-mm play: one episode on film, or in PyBullet's window."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.commands.options import REGISTERED, config_of, with_policies
from marl_mm.commands.parser import parse_options
from marl_mm.envs.demos import DEMOS, Drift
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import episode_row
from marl_mm.eval.video import check_format, write_video
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bars
from marl_mm.runs.play import Direction, check_strip, play, play_demo
from marl_mm.sim.config import Camera


@dataclass(frozen=True)
class Play:
    """Film an episode, or watch it in a window."""

    policy: tyro.conf.Positional[str]
    """Run folder, checkpoint file, "pretrained" or the name of a collector; or the
    robot alone: "arm-reach" (the base stands) or "base-turn" (the arm rests). These two
    take no goal and no task, and hold the arm's posture tightly."""

    video: Path | None = None
    """File of the film, .mp4 or .gif; default episode.mp4, or none with
    --strip."""

    strip: Path | None = None
    """File of six pictures of the episode, side by side: a PNG."""

    direction: Direction | None = None
    """Side of the robot on which the goal is, where the task does not draw its own;
    default backward."""

    seed: int = 0
    """Seed of the goal and of random policies."""

    task: Annotated[
        str | None,
        tyro.conf.arg(help=f"{REGISTERED}; default the run's own, or Reach-v0."),
    ] = None

    max_steps: int | None = None
    """Steps of one second until the episode is cut off; default the task's."""

    fps: int = 10
    """Frames per second of film and of simulated time."""

    gui: bool = False
    """Open PyBullet's window instead of writing a film; needs a screen."""

    overwrite: bool = False
    """Replace what exists."""

    json: bool = False
    """Print the episode's row as JSON."""

    camera: Camera = field(default_factory=Camera)
    """Place of the camera."""

    target: tuple[float, float, float] = (0.8, 0.3, 0.8)
    """Place that the hand reaches in "arm-reach", world x, y, z [m]; it starts at
    0.65, 0.10, 0.58."""

    angle: float = 90.0
    """Angle by which the base turns in "base-turn", -180 to 180 [deg]."""

    seconds: float = 4.0
    """Duration of "arm-reach" and "base-turn" [s]."""

    @property
    def film(self) -> Path | None:
        """The file of the film, if one is to be written."""
        if self.gui or (self.video is None and self.strip is not None):
            return None
        return self.video or Path("episode.mp4")

    @property
    def where(self) -> str:
        """Names of the files that are written, before the line about them."""
        files = ", ".join(str(file) for file in (self.film, self.strip) if file)
        return files and f"{files}: "


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm play``."""
    options = parse_options(with_policies(Play), "marl-mm play", arguments)
    if options.film is not None:
        check_format(options.film)
        refuse_existing(options.film, options.overwrite)
    if options.strip is not None:
        if options.gui or options.policy in DEMOS:
            raise UsageError("--strip is for films of episodes")
        check_strip(options.strip)
        refuse_existing(options.strip, options.overwrite)
    if options.policy in DEMOS:
        _play_demo(options)
        return
    with progress_bars() as bar:
        film = play(
            options.policy,
            task=options.task,
            seed=options.seed,
            direction=options.direction,
            max_steps=options.max_steps,
            fps=options.fps,
            gui=options.gui,
            camera=None if options.camera == Camera() else options.camera,
            progress=bar,
            config=config_of(options.policy, options),
        )
    if options.film is not None:
        film.save(options.film, options.overwrite)
    if options.strip is not None:
        film.strip(options.strip, options.overwrite)
    if options.json:
        print(json.dumps(episode_row(film.episode), indent=2))
        return
    ending = "reached the goal" if film.episode.success else "did not reach the goal"
    steps = len(film.episode)
    print(f"{options.where}{film.policy} {ending} in {steps} steps")


def _play_demo(options: Play) -> None:
    """Run one of the robot's own tests, and say how far the resting half drifted."""
    with progress_bars() as bar:
        drift, frames = play_demo(
            options.policy,
            target=options.target,
            angle=options.angle,
            seconds=options.seconds,
            fps=options.fps,
            gui=options.gui,
            camera=options.camera,
            progress=bar,
        )
    if options.film is not None:
        write_video(options.film, frames, options.fps)
    if options.json:
        print(json.dumps(drift._asdict(), indent=2))
        return
    print(options.where + _in_words(drift))


def _in_words(drift: Drift) -> str:
    base = f"the base drifted {1e3 * drift.base_drift:.1f} mm"
    if drift.position_error is not None and drift.heading_drift is not None:
        reached = "reached its target" if drift.position_error < 0.01 else "fell short"
        return (
            f"the hand {reached}, {1e3 * drift.position_error:.2f} mm off; {base} and "
            f"{math.degrees(drift.heading_drift):.2f} deg at most"
        )
    return (
        f"the base ended {math.degrees(drift.heading_error or 0):.2f} deg off its "
        f"angle; {base}, a joint of the arm {math.degrees(drift.arm_drift or 0):.2f} "
        "deg at most"
    )
