"""marl-mm play: one episode on film, or in PyBullet's window."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from marl_mm.collectors.pd import PdConfig
from marl_mm.commands.options import check_positive, check_seed, named_policy
from marl_mm.commands.parser import parse_options
from marl_mm.envs.config import reach_config
from marl_mm.eval.goals import goal_set
from marl_mm.eval.metrics import episode_row
from marl_mm.eval.video import check_format, film_episode, write_video
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bar
from marl_mm.sim.config import Camera


@dataclass(frozen=True)
class Play:
    """Film an episode, or watch it in a window."""

    policy: tyro.conf.Positional[str]
    """Run folder, checkpoint file, "pd" or "random"."""

    video: Path = Path("episode.mp4")
    """Where to write the film: .mp4 or .gif."""

    direction: Literal["forward", "backward"] = "backward"
    """On which side of the robot the goal is."""

    seed: int = 0
    """Of the goal and of random policies."""

    task: str = "Reach-v0"
    """Reach-v0, SmoothReach-v0 or PreciseReach-v0."""

    max_steps: int = 25
    """Steps of one second until the episode is cut off."""

    fps: int = 10
    """Frames per second of film and of simulated time."""

    gui: bool = False
    """Open PyBullet's window instead of writing a film; needs a screen."""

    overwrite: bool = False
    """Replace the film if it exists."""

    json: bool = False
    """Print the episode's row as JSON."""

    camera: Camera = field(default_factory=Camera)
    """Where to look from."""

    pd: PdConfig = field(default_factory=PdConfig)
    """Gains and alpha of the policy "pd"."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm play``."""
    options = parse_options(Play, "marl-mm play", arguments)
    check_positive(max_steps=options.max_steps, fps=options.fps)
    check_seed(options.seed)
    if not options.gui:
        check_format(options.video)
        refuse_existing(options.video, options.overwrite)
    policy = named_policy(options.policy, options.pd)
    config = reach_config(options.task, {"max_steps": options.max_steps})
    plan = goal_set(config, 2, options.seed)[options.direction == "backward"]
    with progress_bar(f"play {policy.name}", options.max_steps) as advance:
        episode, frames = film_episode(
            config,
            policy,
            plan,
            options.camera,
            0 if options.gui else options.fps,
            options.gui,
            advance,
        )
    if not options.gui:
        write_video(options.video, frames, options.fps)
    if options.json:
        print(json.dumps(episode_row(episode), indent=2))
        return
    ending = "reached the goal" if episode.success else "did not reach the goal"
    where = "" if options.gui else f"{options.video}: "
    print(f"{where}{policy.name} {ending} in {len(episode)} steps")
