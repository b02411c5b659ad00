"""The benchmark's numbers belong together; abuse is counted and limits hold."""

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import marl_mm
from marl_mm.algorithms.registry import names
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.cli import main
from marl_mm.control.config import Form
from marl_mm.datasets import cache
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.bench import data as storing
from marl_mm.eval.bench import learning, offline, online, side_by_side, train
from marl_mm.eval.bench.abuse import abuse
from marl_mm.eval.bench.acting import bench_acting
from marl_mm.eval.bench.control import bench_control
from marl_mm.eval.bench.data import bench_data
from marl_mm.eval.bench.env import bench_env
from marl_mm.eval.bench.learning import bench_learning
from marl_mm.eval.bench.offline import (
    AUTHORS,
    PLAIN,
    bench_offline,
    bench_seeds,
    plain_config,
)
from marl_mm.eval.bench.online import bench_online, bench_success
from marl_mm.eval.bench.side_by_side import bench_gpu, bench_side_by_side
from marl_mm.eval.bench.tables import env_table, tick_table, vector_table
from marl_mm.eval.bench.td3_bc_reference import PlainTd3Bc
from marl_mm.progress import Advance, silent_bar
from marl_mm.sim.config import Engine


@pytest.mark.slow
def test_parts_of_a_tick_belong_together() -> None:
    result = bench_control(make_task("Reach-v0"), steps=3, seed=0)
    us = {name: spread["median"] for name, spread in result["us"].items()}
    assert us["simulation"] + us["controller"] + us["io"] < 1.3 * us["tick"]
    assert us["assembly"] + us["levels"] < us["solve"] < us["controller"]
    ratio = us["controller"] / us["simulation"]
    assert result["controller_over_simulation"] == pytest.approx(ratio)
    for spread in result["us"].values():
        assert spread["median"] <= spread["p99"] <= spread["max"]
    references = result["references_us"]
    names = {"compiled", "numpy_proxqp", "numpy_daqp", "pink_weighted_qp"}
    assert set(references) == names
    assert references["compiled"]["median"] < references["numpy_proxqp"]["median"]
    assert set(result["infeasible_us"]) == {"compiled", "numpy_proxqp"}


@pytest.mark.slow
def test_engines_are_timed_in_turns() -> None:
    engines: tuple[Engine, ...] = ("bullet", "mujoco")
    result = bench_env("Reach-v0", engines, 1, 1, 0, 2, 2, silent_bar)
    loop = "mujoco, loop in Python"
    for label in ("random alpha", "alpha 1"):
        speeds = result[f"{label}: steps/s"]
        assert set(speeds) == {*engines, loop} and min(speeds.values()) > 0
        assert set(result[f"{label}: times the steps/s of bullet"]) == {"mujoco", loop}
    parts = result["mujoco: us of a tick"]
    assert sum(parts.values()) == pytest.approx(2 * parts["all"])
    vectors = result["vector of 2, 2 workers: times the steps/s of one"]
    assert set(vectors) == set(engines) and min(vectors.values()) > 0
    alone = bench_env("Reach-v0", ["mujoco"], 1, 1, 0, 2, 1, silent_bar)
    assert not any("of bullet" in quantity for quantity in alone)
    results = {"Reach-v0": {"options": {"vector": 2, "workers": 1}, **alone}}
    assert "| - |" in env_table(results) and "| - |" in vector_table(results)
    assert "controller" in tick_table(results)


@pytest.mark.parametrize("words", [[], ["mujoco", "mujoco"]])
@pytest.mark.parametrize("what", ["env", "learning"])
def test_no_engine_and_one_twice_are_refused(
    what: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", what, "--engine", *words]) == 2
    assert "expected each at most once, and one" in capsys.readouterr().err


@pytest.mark.slow
def test_learning_is_timed_to_the_episodes_of_training(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(learning, "RATE", 0.0)  # the first evaluation ends it
    monkeypatch.setattr(learning, "GOALS", (4, 1))
    result = bench_learning("Reach-v0", ["ddpg-her"], ["mujoco"], [3], 2, silent_bar)
    assert result["ddpg-her: episodes to 0%"] == {"mujoco": [40]}
    assert result["ddpg-her: seconds"]["mujoco"][0] > 0
    assert result["ddpg-her: times the seconds of mujoco"] == {}


def test_learning_is_compared_in_all_and_by_the_episode(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By hand: 10 s for 100 episodes, and 4 s for 50."""
    clock = iter([0.0, 10.0, 10.0, 14.0])
    monkeypatch.setattr(learning, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(learning, "_learn", lambda *g: 100 if "bullet" in g else 50)
    engines: list[Engine] = ["bullet", "mujoco"]
    result = bench_learning("Reach-v0", ["ddpg-her"], engines, [0], 2, silent_bar)
    for unit, ratio in (("seconds", 0.4), ("seconds an episode", 0.8)):
        compared = result[f"ddpg-her: times the {unit} of bullet"]
        assert compared == {"mujoco": pytest.approx(ratio)}


@pytest.mark.slow
@pytest.mark.parametrize("form", ["blend", "rhp"])
def test_abuse_in_closed_loop_keeps_the_limits(form: Form) -> None:
    """A bounded piece of ``marl-mm bench abuse``: 100 s of flung targets."""
    config = make_task("Reach-v0", {"controller": {"form": form}})
    result = abuse(config, 24_000, seed=6)
    worst = result["worst_excess"]
    for name in (
        "joint_position_rad",
        "joint_velocity_share",
        "base_speed_share",
        "base_yaw_rate_share",
        "wheel_speed_share",
    ):
        assert worst[name] <= 0, name
    assert worst["commanded_acceleration_share"] < 1e-3
    assert worst["joint_torque_share"] < 1e-6
    assert worst["keep_out_m"] < 0.01
    # Over single ticks, where a flung arm takes the load off a wheel, which slips.
    assert worst["measured_joint_acceleration_share"] < 0.3
    assert worst["measured_base_acceleration_share"] < 0.3
    assert result["ticks"] == 24_000
    assert result["failed_levels"] == sum(result["reasons"].values()) == 0
    assert result["safe_ticks"] == 0
    assert result["least_zmp_margin_m"] > 0
    assert result["largest_model_ee_error_m"] < 1e-3


def test_abuse_is_seeded() -> None:
    config = make_task("Reach-v0", {"ticks_per_step": 60})
    one, other = (abuse(config, 300, seed=1) for _ in range(2))
    for each in (one, other):
        assert each.pop("longest_controller_tick_us") > 1
    assert one == other


@pytest.mark.slow
def test_bench_online_times_ours_and_theirs_in_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(online, "_TURN", 10)
    counts: list[int] = []
    result = bench_online(
        20, episodes=1, advance=lambda done, note: counts.append(done)
    )
    names = {"ddpg-her", "ddpg-her-no-layer-norm", "maddpg-her", "sb3-ddpg-her"}
    assert sum(counts) == 20 * len(names)
    assert result["updates_per_second"].keys() == names
    assert all(rate > 0 for rate in result["updates_per_second"].values())
    assert result["ddpg-her_over_sb3"] > 0
    alone = bench_online(10, sb3=False, episodes=1)
    assert alone["updates_per_second"].keys() == names - {"sb3-ddpg-her"}


@pytest.mark.slow
def test_bench_success_compares_success_after_equal_steps() -> None:
    counts: list[int] = []
    success = bench_success(30, goals=2, advance=lambda done, note: counts.append(done))
    assert success.keys() == {"ddpg-her", "sb3-ddpg-her"}
    for measured in success.values():
        low, high = measured["interval"]
        assert 0 <= low <= measured["success_rate"] <= high <= 1
    assert 2 * 30 <= sum(counts) < 2 * 30 + 5 * 25  # whole cycles, whole episodes


@pytest.mark.slow
def test_bench_offline_times_all_in_turns() -> None:
    counts: dict[str, int] = {}

    def bar(label: str, total: int) -> Advance:
        counts["planned"] = total

        def advance(done: int, note: str = "") -> None:
            counts[note] = counts.get(note, 0) + done

        return advance

    timings = bench_offline(1, 0, None, bar)
    planned = counts.pop("planned")
    assert set(counts.values()) == {2 * 1} and planned == sum(counts.values())
    offline = {*names(online=False)}
    for timing in timings.values():
        assert offline < set(timing) == set(counts)
        rates = {name: row["updates_per_second"] for name, row in timing.items()}
        assert min(rates.values()) > 0
        ratio = rates[PLAIN] / rates[AUTHORS]
        row = timing[PLAIN]  # of a single turn
        assert row["over_reference"] == pytest.approx(ratio)
        assert row["reference"] == AUTHORS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--env-steps", "-3"], "--env-steps is -3, expected >= 0"),
        (["--seeds", "0"], "--seeds is 0"),
        (["--d3rlpy", "/nowhere/python"], "/nowhere/python does not run"),
    ],
)
def test_a_comparison_that_makes_no_sense_is_refused_at_once(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "train", *words]) == 2
    assert complaint in capsys.readouterr().err


def test_a_python_without_d3rlpy_is_refused() -> None:
    with pytest.raises(UsageError, match=r"no d3rlpy that works: .*d3rlpy"):
        bench_offline(3, 0, Path(sys.executable), silent_bar)
    with pytest.raises(UsageError, match="/nowhere does not run: No such file"):
        bench_offline(3, 0, Path("/nowhere"), silent_bar)
    with pytest.raises(UsageError, match="it ended without a word"):
        bench_offline(3, 0, Path("/bin/true"), silent_bar)


@pytest.mark.slow
def test_storage_is_timed_with_a_cache_of_its_own(
    datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storing, "_TURNS", 1)
    before = cache.entries()
    result = bench_data(1, (1,), 300, 0, silent_bar)
    storage = result["storage"]
    assert storage["load_cold_s"] > 0 and storage["cache_mb"] > 0
    assert cache.entries() == before


@pytest.mark.slow
def test_bench_seeds_runs_the_command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    marl_mm.collect("pd", dataset=tmp_path / "data", steps=40, engine="mujoco")
    monkeypatch.setattr(offline, "SHIPPED", str(tmp_path / "data"))
    counts: list[int] = []
    result = bench_seeds(20, 2, 1, lambda done, note: counts.append(done))
    assert counts == [1, 2]
    assert min(result["one_memory_mib"], result["several_memory_mib"]) > 100
    expected = result["several_s"] / result["one_s"]
    assert result["cost_over_one"] == pytest.approx(expected)
    failing = tmp_path / "python"
    failing.write_text("#!/bin/sh\necho 'marl-mm: no' >&2\nexit 1\n")
    failing.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(failing))
    with pytest.raises(MarlMmError, match=r"train td3-bc .* failed: marl-mm: no"):
        bench_seeds(20, 2, 1)


def test_side_by_side_counts_all_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU; the CPU can do it, too."""
    monkeypatch.setattr(
        side_by_side, "perf_counter", itertools.count(0.0, 2.0).__next__
    )
    counts: list[int] = []

    def advance(done: int, note: str) -> None:
        counts.append(done)

    rates = bench_side_by_side("td3-bc", 5, (1, 3), "cpu", advance)
    assert counts == [5, 5] and rates == {"1": 5 / 2, "3": 3 * 5 / 2}


def test_without_a_gpu_its_benchmark_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match="finds no GPU"):
        bench_gpu(5, silent_bar)


def test_the_command_times_all_or_the_gpu(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(train, "bench_train", lambda *settings: {"offline": 1})
    assert main(["bench", "train", "--json"]) == 0
    assert '"offline": 1' in capsys.readouterr().out
    assert main(["bench", "train", "--gpu"]) == 2
    assert "--gpu is set, but torch finds no GPU" in capsys.readouterr().err


def test_acting_is_timed_for_all() -> None:
    times = bench_acting((8,), 0, 20)
    assert tuple(times) == names(online=False)
    assert all(0 < one["median"] <= one["p99"] for one in times.values())


def ours_in_their_order(ours: Td3Bc) -> list[torch.Tensor]:
    """Weights and biases of the actor, the first critic and the second one."""
    names = [f"{layer}.{kind}" for layer in (0, 2, 4) for kind in ("weight", "bias")]
    critic = ours.critics.networks.member
    members = ours.actors.networks["joint"].member(0), critic(0), critic(1)
    return [member[name] for member in members for name in names]


def theirs_in_order(*networks: torch.nn.Module) -> list[torch.Tensor]:
    """The same of their actor and critic."""
    return [
        one.state_dict()[f"l{number}.{kind}"]
        for one in networks
        for number in range(1, len(one.state_dict()) // 2 + 1)
        for kind in ("weight", "bias")
    ]


def test_ours_without_its_additions_is_the_authors() -> None:
    """From the same weights, on the same batches and noise: the same networks."""
    config = replace(plain_config(), hidden=(16, 16), batch_size=32)
    arrays, rewards = shipped_arrays(), make_task()
    ours, twin = (Td3Bc(config, arrays, rewards, [0]) for _ in range(2))
    theirs = PlainTd3Bc(arrays, config, 0)
    learning = theirs.actor, theirs.critic
    for pair in (learning, (theirs.actor_target, theirs.critic_target)):
        for mine, other in zip(
            theirs_in_order(*pair), ours_in_their_order(ours), strict=True
        ):
            mine.copy_(other)
    for _ in range(6):
        batch = twin._batches.next()
        theirs.learn(
            twin.normalizer(batch.observation[0]),
            batch.action[0],
            twin.normalizer(batch.next_observation[0]),
            batch.reward[0][:, None],
            1 - batch.terminated[0][:, None],
            batch.noise[0],
        )
        ours.update()
    for mine, other in zip(
        theirs_in_order(*learning), ours_in_their_order(ours), strict=True
    ):
        torch.testing.assert_close(mine, other, atol=1e-6, rtol=1e-5)
