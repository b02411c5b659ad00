"""Evaluation: fixed goals, hand-worked summaries, results independent of workers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.commands.output import print_evaluations
from marl_mm.envs.rollout import episode_seed
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.eval.figures import alpha_over_time, learning_curve
from marl_mm.eval.goals import goal_set
from marl_mm.eval.metrics import (
    count_failures,
    episode_row,
    failures_in_words,
    summarize_directions,
)
from marl_mm.eval.tables import evaluation_markdown
from marl_mm.eval.video import (
    film_both_ways,
    film_episode,
    film_strip,
    pictures_of,
    strips_both_ways,
    write_video,
)
from marl_mm.sim.config import Camera

MakeEpisode = Callable[..., Episode]
QUICK = {"ticks_per_step": 24, "max_steps": 3}


def row(direction: str, success: bool, steps: int) -> Any:
    numbers = dict.fromkeys(("return", "d_mm", "d_mp", "base_jerk_rms", "alpha"), 1.0)
    return {"direction": direction, "success": success, "steps": steps, **numbers}


def test_goals_alternate_lie_in_the_paper_s_boxes_and_extend() -> None:
    config = Reach()
    plans = goal_set(config, 40, seed=3)
    goals = np.array([plan.goal for plan in plans])
    ahead, behind = goals[::2], goals[1::2]
    assert ((ahead[:, 0] > 1.0) & (ahead[:, 0] < 1.5)).all()
    assert ((behind[:, 0] > -0.8) & (behind[:, 0] < -0.5)).all()
    assert (np.abs(goals[:, 1]) < 0.2).all()
    assert ((goals[:, 2] > 0.55) & (goals[:, 2] < 0.8)).all()
    assert goal_set(config, 10, seed=3) == plans[:10]
    assert goal_set(config, 10, seed=4) != plans[:10]


def test_summary_by_hand() -> None:
    rows = [
        row("forward", True, 6),
        row("forward", True, 8),
        row("backward", False, 25),
        row("backward", True, 16),
    ]
    summary = summarize_directions(rows)
    assert summary["all"]["success_rate"] == 0.75
    assert summary["all"]["steps_to_success"] == 10
    assert summary["forward"]["success_rate"] == 1.0
    assert summary["backward"]["success_rate"] == 0.5
    assert summary["backward"]["steps_to_success"] == 16


def test_a_notebook_shows_rates_with_intervals_and_names_as_text() -> None:
    rows = [row("forward", True, 6), row("backward", False, 25)]
    page = Evaluation("<b>mine</b>", {}, "Reach-v0", {}, 0, rows)._repr_html_()
    assert page.startswith("<table><tr><th>policy</th><th>goals</th>")
    assert page.count("<td>&lt;b&gt;mine&lt;/b&gt;</td>") == 3 and "<b>" not in page
    assert "<td>2 all</td><td>50.0 [9.5, 90.5]</td><td>6.0</td>" in page


def test_a_line_break_in_a_name_makes_no_row_on_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = [row("forward", True, 6)]
    print_evaluations([Evaluation("a\nb", {}, "Reach-v0", {}, 0, rows)])
    assert r"a\nb " in capsys.readouterr().out


def test_no_success_has_no_steps_to_success() -> None:
    summary = summarize_directions([row("forward", False, 25)])
    assert summary["all"]["steps_to_success"] is None
    assert "backward" not in summary


def test_failures_are_counted_by_kind_where_they_are_known() -> None:
    assert count_failures([row("forward", True, 6)]) is None
    reasons = ("", "dropped", "collision of a and b", "collision of a and c")
    rows = [row("forward", not why, 6) | {"reason": why} for why in reasons]
    failures = count_failures(rows)
    assert failures == {"collision": 2, "dropped": 1}
    assert failures_in_words(failures) == "collision 2, dropped 1"
    assert failures_in_words({}) == "none"


def test_row_is_what_the_episode_says(make_episode: MakeEpisode) -> None:
    episode = make_episode(1, steps=4)
    values = episode_row(episode)
    assert values["direction"] == "forward"
    assert values["steps"] == 4
    assert values["return"] == pytest.approx(episode.rewards.sum())
    assert values["zmp_margin"] == episode.info["zmp_margin"].min()


@pytest.mark.slow
def test_workers_do_not_change_an_evaluation() -> None:
    policy = RandomPolicy(RandomConfig())
    one = evaluate(policy, 6, seed=1, overrides=QUICK)
    two = evaluate(policy, 6, seed=1, overrides=QUICK, workers=2)
    assert one.to_json() == two.to_json()
    assert one.rows != evaluate(policy, 6, seed=2, overrides=QUICK).rows


@pytest.mark.slow
def test_pd_reaches_goals_that_random_misses() -> None:
    assert evaluate(PdPolicy(PdConfig()), 4).success_rate == 1.0
    assert evaluate(RandomPolicy(RandomConfig()), 4).success_rate == 0.0


class Describing(PdPolicy):
    """It says something of itself."""

    about: Any = None

    def describe(self) -> dict[str, Any]:
        return {"about": self.about}


def test_a_policy_may_describe_itself_by_what_json_has() -> None:
    policy = Describing(PdConfig())
    policy.about = [np.float32(0.5), np.arange(2)]
    evaluation = evaluate(policy, 1, overrides=QUICK)
    assert evaluation.policy_config == {"about": [0.5, [0, 1]]}
    for odd in (np.nan, {1, 2}):
        policy.about = odd
        with pytest.raises(
            UsageError, match=r"describes itself by .*, expected finite"
        ):
            evaluate(policy, 1, overrides=QUICK)


@pytest.mark.parametrize(("episodes", "seed"), [(0, 0), (-1, 0), (1, -1)])
def test_bad_numbers_are_refused(episodes: int, seed: int) -> None:
    with pytest.raises(UsageError, match="expected >= "):
        evaluate(RandomPolicy(RandomConfig()), episodes, seed)


def test_markdown_table_has_a_row_per_direction() -> None:
    rows = [row("forward", True, 6), row("backward", False, 25)]
    text = evaluation_markdown([Evaluation("pd", {}, "Reach-v0", {}, 0, rows)])
    lines = text.splitlines()
    assert len(lines) == 2 + 3
    assert "| pd | 1 forward | 100.0 [20.7, 100.0] | 6.0 |" in text


def test_figures_are_drawn(tmp_path: Path, make_episode: MakeEpisode) -> None:
    metrics = [
        {"step": 0, "success/all": 0.0},
        {"step": 100, "loss/balance": 0.1, "success/all": 0.5},
    ]
    learning_curve(metrics, tmp_path / "curve.png")
    alpha_over_time({"pd": [make_episode(0), make_episode(1)]}, tmp_path / "alpha.png")
    for name in ("curve.png", "alpha.png"):
        assert (tmp_path / name).stat().st_size > 5_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_has_the_frames_of_the_episode(tmp_path: Path, name: str) -> None:
    import imageio_ffmpeg

    camera = Camera(width=96, height=64)
    config = Reach(max_steps=2)
    episode, frames = film_episode(
        config, PdPolicy(PdConfig()), goal_set(config, 1, 0)[0], camera, fps=8
    )
    assert len(episode) == 2
    assert len(frames) == 2 * 8 + 1
    assert frames[0].shape == (64, 96, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 0  # it moves
    write_video(tmp_path / name, frames, 8)
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / name))
    assert count == len(frames)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    at_half_seconds = pictures_of([*frames[:1]] * 11, 10 * 0.5)  # at 10 frames a second
    assert [name for name, _ in at_half_seconds] == [
        f"step {n}" for n in (0, 0, 1, 1, 2)
    ]
    film_strip(tmp_path / "strip.png", [("pd", [("step 0", frames[0])])])
    assert (tmp_path / "strip.png").exists()


@pytest.mark.slow
@pytest.mark.bullet
def test_strips_are_those_of_a_whole_film(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures and steps, where an episode has fewer frames than pictures, too."""
    monkeypatch.setattr(Reach, "camera", Camera(96, 64, yaw=10.0))
    for seconds in (2, 4):
        task, policy = Reach(max_steps=seconds), PdPolicy(PdConfig())
        whole = film_both_ways(task, policy, 0, 1).strips
        for (label, pictures), (same, again) in zip(
            whole, strips_both_ways(task, policy, 0), strict=True
        ):
            assert label == same
            for (note, picture), (known, drawn) in zip(pictures, again, strict=True):
                assert note == known
                np.testing.assert_array_equal(picture, drawn)


@pytest.mark.slow
@pytest.mark.parametrize("fps", [7, 25])
def test_film_time_is_simulated_time(fps: int) -> None:
    config = Reach(max_steps=2)
    plan = goal_set(config, 1, 0)[0]
    camera = Camera(width=32, height=32)
    _, frames = film_episode(config, PdPolicy(PdConfig()), plan, camera, fps)
    assert len(frames) == 2 * fps + 1


def test_an_unknown_film_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.mp4 or \.gif"):
        write_video(tmp_path / "film.avi", [np.zeros((4, 4, 3), np.uint8)], 8)


def test_every_metric_of_a_row_is_what_it_says(make_episode: MakeEpisode) -> None:
    episode = make_episode(1, steps=4)
    info, row = episode.info, episode_row(episode)
    by_hand = {
        "final_distance": info["distance"][-1],
        "d_mm": info["d_mm"].mean(),
        "d_mp": info["d_mp"].mean(),
        "base_jerk_rms": info["base_jerk_rms"].mean(),
        "zmp_margin": info["zmp_margin"].min(),
        "alpha": episode.actions[:, 3].mean(),
        "qp_failures": info["qp_failures"].sum(),
    }
    assert {name: row[name] for name in by_hand} == pytest.approx(by_hand)  # type: ignore[literal-required]


def test_only_evaluations_on_the_same_goals_are_compared() -> None:
    """Of the same task, and goal by goal: a difference is paired."""

    def evaluation(task: str = "Reach-v0", **second: object) -> Evaluation:
        rows = [row("forward", True, 6) | {"seed": n, "goal": [0.5]} for n in range(2)]
        rows[1] |= second
        return Evaluation("pd", {}, task, {}, 0, rows)

    same = evaluation()
    worse = evaluation(success=False)
    assert worse.less(same)[0] == -0.5 and same.less(worse)[0] == 0.5
    others = evaluation("PreciseReach-v0"), evaluation(seed=7), evaluation(goal=[0.6])
    for other in (*others, Evaluation("pd", {}, "Reach-v0", {}, 0, same.rows[:1])):
        with pytest.raises(UsageError, match="are not on the same goals"):
            same.less(other)


def test_an_evaluation_begins_in_no_state_of_a_dataset_or_of_training() -> None:
    """Whatever the seeds: streams of one seed are told apart by what they are for."""
    seeds = {plan.seed for plan in goal_set(Reach(), 50, seed=3)}
    assert seeds == {episode_seed(3, n, "evaluate") for n in range(50)}
    for purpose in ("collect", "train"):
        assert not seeds & {episode_seed(3, n, purpose) for n in range(50)}
