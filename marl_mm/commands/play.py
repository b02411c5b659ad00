"""marl-mm play: one episode on film, or in PyBullet's window."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from marl_mm.commands.options import (
    REGISTERED,
    check_positive,
    check_seed,
    named_policy,
    own_task,
    with_policies,
)
from marl_mm.commands.parser import parse_options
from marl_mm.envs.demos import DEMOS, Drift, arm_reach, base_turn, demo_drive
from marl_mm.envs.drive import Drive, Tick, Watch
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.goals import goal_set
from marl_mm.eval.metrics import episode_row
from marl_mm.eval.video import (
    Film,
    check_format,
    film_episode,
    film_strip,
    pictures_of,
    write_video,
)
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bar
from marl_mm.sim.config import RATE, Camera


@dataclass(frozen=True)
class Play:
    """Film an episode, or watch it in a window."""

    policy: tyro.conf.Positional[str]
    """Run folder, checkpoint file, "pretrained" or the name of a collector; or the
    robot alone: "arm-reach" (the base stands) or "base-turn" (the arm rests). These two
    take no goal and no task, and hold the arm's posture tightly."""

    video: Path | None = None
    """Where to write the film, .mp4 or .gif; default episode.mp4, or none with
    --strip."""

    strip: Path | None = None
    """Where to write six pictures of the episode, side by side: a PNG."""

    direction: Literal["forward", "backward"] | None = None
    """On which side of the robot the goal is, where the task does not draw its own;
    default backward."""

    seed: int = 0
    """Of the goal and of random policies."""

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
    """Where to look from."""

    target: tuple[float, float, float] = (0.8, 0.3, 0.8)
    """Where the hand goes in "arm-reach", world x, y, z [m]; it starts at 0.65, 0.10,
    0.58."""

    angle: float = 90.0
    """How far the base turns in "base-turn", -180 to 180 [deg]."""

    seconds: float = 4.0
    """How long "arm-reach" and "base-turn" take [s]."""

    @property
    def film(self) -> Path | None:
        """The file of the film, if one is to be written."""
        if self.gui or (self.video is None and self.strip is not None):
            return None
        return self.video or Path("episode.mp4")

    @property
    def where(self) -> str:
        """What is written, before what is told of it."""
        files = ", ".join(str(file) for file in (self.film, self.strip) if file)
        return files and f"{files}: "


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm play``."""
    options = parse_options(with_policies(Play), "marl-mm play", arguments)
    check_positive(fps=options.fps)
    overrides = {}
    if options.max_steps is not None:
        check_positive(max_steps=options.max_steps)
        overrides["max_steps"] = options.max_steps
    check_seed(options.seed)
    if options.film is not None:
        check_format(options.film)
        refuse_existing(options.film, options.overwrite)
    if options.strip is not None:
        if options.gui or options.policy in DEMOS or options.strip.suffix != ".png":
            raise UsageError("--strip is for films of episodes, and ends in .png")
        refuse_existing(options.strip, options.overwrite)
    if options.policy in DEMOS:
        _play_demo(options)
        return
    task = options.task or own_task([options.policy])
    own = make_task(task, overrides)
    policy = named_policy(options.policy, options, own, DEMOS)
    ahead, behind = goal_set(own, 2, options.seed)
    if options.direction is not None and ahead.goal is None:
        raise UsageError(f"--direction is not for {task}: its seed draws the goal")
    plan = ahead if options.direction == "forward" else behind
    with progress_bar(f"play {policy.name}", own.max_steps) as advance:
        episode, frames = film_episode(
            own,
            policy,
            plan,
            own.camera if options.camera == Camera() else options.camera,
            0 if options.gui else options.fps,
            options.gui,
            advance,
        )
    if options.film is not None:
        write_video(options.film, frames, options.fps)
    if options.strip is not None:
        label = f"{task}: {len(episode)} steps"
        pictures = pictures_of(frames, options.fps, 6)
        film_strip(options.strip, [(label, pictures)])
    if options.json:
        print(json.dumps(episode_row(episode), indent=2))
        return
    ending = "reached the goal" if episode.success else "did not reach the goal"
    print(f"{options.where}{policy.name} {ending} in {len(episode)} steps")


def _play_demo(options: Play) -> None:
    """Run one of the robot's own tests, and say how far the resting half drifted."""
    if not 0.1 <= options.seconds <= 60:
        raise UsageError(f"--seconds is {options.seconds}, expected 0.1 to 60")
    if not -180 <= options.angle <= 180:
        raise UsageError(f"--angle is {options.angle}, expected -180 to 180 degrees")
    if not all(map(math.isfinite, options.target)):
        raise UsageError(f"--target is {options.target}, expected finite numbers [m]")
    drive = demo_drive(visual=True, gui=options.gui)
    film = Film(drive.world, options.camera, 0 if options.gui else options.fps)
    try:
        ticks = round(options.seconds * RATE)
        with progress_bar(f"play {options.policy}", ticks) as advance:

            def watch(tick: Tick) -> None:
                film(tick)
                advance(1, "")

            drift = _run_demo(options, drive, watch)
        film.add()
    finally:
        drive.close()
    if options.film is not None:
        write_video(options.film, film.frames, options.fps)
    if options.json:
        print(json.dumps(drift._asdict(), indent=2))
        return
    print(options.where + _told(drift))


def _told(drift: Drift) -> str:
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


def _run_demo(options: Play, drive: Drive, watch: Watch) -> Drift:
    if options.policy == "arm-reach":
        return arm_reach(drive, np.array(options.target), options.seconds, watch)
    return base_turn(drive, math.radians(options.angle), options.seconds, watch)
