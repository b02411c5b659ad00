"""marl-mm play: one episode on film, or in PyBullet's window."""

import math
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.commands.options import CollectorsSettings, OwnTask, configs_of
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.envs.demos import DEMOS, Drift
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import episode_row
from marl_mm.eval.video import check_format, write_video
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bars
from marl_mm.runs.play import (
    Direction,
    Motion,
    View,
    check_strip,
    default_policy,
    play,
    play_demo,
)
from marl_mm.runs.policies import own_task
from marl_mm.sim.config import Camera, Engine

_VIEW, _MOTION = View(), Motion()


@command
def main(
    policy: tyro.conf.Positional[str | None] = None,
    *,
    video: Path | None = None,
    strip: Path | None = None,
    direction: Direction | None = None,
    seed: int | None = None,
    task: OwnTask = None,
    max_steps: int | None = None,
    engine: Engine | None = None,
    fps: int = 10,
    gui: bool = False,
    overwrite: bool = False,
    json: bool = False,
    camera: View = _VIEW,
    motion: Annotated[Motion, tyro.conf.arg(name="")] = _MOTION,
    settings: CollectorsSettings,
) -> None:
    """Film an episode, or watch it in a window.

    Args:
        policy: Run folder, checkpoint file, "pretrained" or the name of a collector; or
            the robot alone: "arm-reach" (the base stands) or "base-turn" (the arm
            rests). These two take no goal and no task, and hold the arm's posture
            tightly. Default the task's script, or pd where it has none.
        video: Film, .mp4 or .gif; default episode.mp4, or none with --strip.
        strip: File of six pictures of the episode, side by side: a PNG.
        direction: Side of the robot on which the goal is, where the task does not draw
            its own; default backward.
        seed: Seed of the goal and of random policies; default 0.
        task: Registered name of the task.
        max_steps: Steps of one second until the episode is cut off; default the task's.
        engine: Engine; default the run's own, or bullet, or mujoco without PyBullet.
        fps: Frames per second of film and of simulated time.
        gui: Open PyBullet's window instead of writing a film; needs a screen.
        overwrite: Replace what exists.
        json: Print the episode's row as JSON.
        camera: Settings of the camera; default the task's.
        motion: Motion of the robot alone.
        settings: Settings of collectors' policies.
    """
    policy = default_policy(task or DEFAULT) if policy is None else policy
    (config,) = configs_of([policy], settings)
    of_episodes: dict[str, Any] = {"--seed": seed, "--task": task, "--engine": engine}
    of_episodes |= {"--max-steps": max_steps, "--direction": direction}
    given = [name for name, value in of_episodes.items() if value is not None]
    if policy in DEMOS and given:
        raise UsageError(f"{' and '.join(given)}: {policy} has no task or goal")
    if policy not in DEMOS and motion != _MOTION:
        raise UsageError(f"{policy} has no such motion: {' and '.join(DEMOS)} have")
    if gui and video is not None:
        raise UsageError("--gui opens a window: leave out --video")
    if gui or (video is None and strip is not None):
        video = None
    else:
        video = video or Path("episode.mp4")
        check_format(video)
        refuse_existing(video, overwrite, file=True)
    if strip is not None:
        if gui or policy in DEMOS:
            raise UsageError("--strip is for films of episodes")
        check_strip(strip)
        refuse_existing(strip, overwrite, file=True)
    files = ", ".join(str(file) for file in (video, strip) if file)
    written = files and f"{files}: "
    if policy in DEMOS:
        with progress_bars() as bar:
            view = camera.of(Camera())
            drift, frames = play_demo(
                policy, motion, fps=fps, gui=gui, camera=view, progress=bar
            )
        if video is not None:
            write_video(video, frames, fps)
        show(drift._asdict(), written + _in_words(drift), json)
        return
    with progress_bars() as bar:
        film = play(
            policy,
            task=task,
            seed=seed or 0,
            direction=direction,
            max_steps=max_steps,
            engine=engine,
            fps=fps,
            gui=gui,
            camera=camera.of(make_task(task or own_task([policy])).camera),
            config=config,
            progress=bar,
        )
    if video is not None:
        film.save(video, overwrite)
    if strip is not None:
        film.strip(strip, overwrite)
    ending = "reached the goal" if film.episode.success else "did not reach the goal"
    where = f"{len(film.episode)} steps on {film.engine}"
    row = {**episode_row(film.episode), "engine": film.engine}
    show(row, f"{written}{film.policy} {ending} in {where}", json)


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
