"""The online loop: interrupted and resumed, flat, best; and what its runs show."""

import json
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import (
    EventAccumulator,
)

from marl_mm.algorithms import online
from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.maddpg import Maddpg
from marl_mm.algorithms.maddpg_config import MaddpgConfig
from marl_mm.algorithms.online import BeginEvaluation, is_flat, train_online
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.pretrained import load_pretrained, ship
from marl_mm.algorithms.registry import preset
from marl_mm.algorithms.runlog import CurvePoint, RunLog, read_metrics
from marl_mm.algorithms.schedule import Schedule
from marl_mm.algorithms.train import resume
from marl_mm.cli import main
from marl_mm.contracts.learners import UNUSUAL, several_layouts
from marl_mm.datasets import load_dataset
from marl_mm.declared import as_record
from marl_mm.envs.parallel import split_action
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import CheckpointError, DivergedError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.files import only_here
from marl_mm.progress import silent
from marl_mm.runs.checks import check_training
from marl_mm.runs.training import training_of

MakeEpisode = Callable[..., Episode]
RunEpisodes = Callable[[Explorer, Iterable[int]], Iterator[Episode]]
JUDGE = make_task()
SCHEDULE = Schedule(epoch=5, evaluate_every=1, patience=0)
CONFIG = DdpgConfig(
    episodes=30,
    updates_per_episode=2,
    warm_up=30,
    capacity=100,
    batch_size=16,
    hidden=(8, 8),
)


@pytest.fixture
def run_episodes(make_episode: MakeEpisode) -> RunEpisodes:
    """Episodes of their number and of what the policy does, without a simulator."""

    def run(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
        for number in numbers:
            episode = make_episode(number, steps=4)
            policy.begin(np.random.default_rng(number), REACH)
            actions = np.stack([policy.act(state) for state in episode.states[:-1]])
            yield replace(episode, actions=actions)

    return run


def weighed(policy: LearnedPolicy) -> CurvePoint:
    """A deterministic function of the policy in place of an evaluation."""
    action = policy.act(np.ones(10))
    rate = float(abs(action[0]))
    return {"success/all": rate, "return/all": float(action[1])}


def files(run: Path) -> dict[str, object]:
    """What a run's folder says, without clocks and containers."""

    def plain(value: object) -> object:
        if isinstance(value, torch.Tensor):
            return value.numpy().tobytes()
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items()}
        if isinstance(value, list | tuple):
            return [plain(one) for one in value]
        return value

    contents: dict[str, object] = {"metrics": (run / "metrics.jsonl").read_bytes()}
    for name in (FILE, BEST):
        contents[name] = plain(torch.load(run / name, weights_only=True)["state"])
    return contents


@pytest.mark.parametrize(
    ("kind", "config"), [(Ddpg, CONFIG), (Maddpg, MaddpgConfig(**vars(CONFIG)))]
)
def test_an_interrupted_and_resumed_run_equals_an_uninterrupted_one(
    kind: type[Ddpg], config: DdpgConfig, run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    """Stopped by a real KeyboardInterrupt in the middle of an epoch, then resumed."""
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    whole.mkdir()
    stopped.mkdir()
    train_online(
        kind(config, JUDGE, 3, (), REACH), whole, run_episodes, weighed, SCHEDULE
    )

    def interrupted(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
        for episode in run_episodes(policy, numbers):
            if episode.index == 17:
                raise KeyboardInterrupt
            yield episode

    cut = kind(config, JUDGE, 3, (), REACH)
    with pytest.raises(KeyboardInterrupt, match="episode 15: go on with `resume=True`"):
        train_online(cut, stopped, interrupted, weighed, SCHEDULE)
    assert cut.episodes > 15  # it had gone further than its checkpoint
    again = kind(config, JUDGE, 3, (), REACH)
    resume(again, stopped)
    assert again.episodes == 15
    train_online(again, stopped, run_episodes, weighed, SCHEDULE)
    assert files(whole) == files(stopped)


@pytest.fixture
def begin() -> Iterator[BeginEvaluation]:
    """``weighed``, in a thread that takes longer than an epoch."""

    def late(policy: LearnedPolicy) -> CurvePoint:
        time.sleep(0.05)
        return weighed(policy)

    with ThreadPoolExecutor(1) as thread:
        yield lambda policy: thread.submit(late, policy)


def test_evaluations_beside_the_next_epoch_change_nothing(
    run_episodes: RunEpisodes, begin: BeginEvaluation, tmp_path: Path
) -> None:
    """They see the policy of their epoch, and what they are of is kept after them."""
    fresh = partial(Ddpg, CONFIG, JUDGE, 3, (), REACH)
    runs = [tmp_path / name for name in ("between", "beside")]
    for run in runs:
        run.mkdir()
    train_online(fresh(), runs[0], run_episodes, weighed, SCHEDULE)

    def interrupted(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
        for episode in run_episodes(policy, numbers):
            if episode.index == 17:
                raise KeyboardInterrupt
            yield episode

    rest = weighed, SCHEDULE, silent, (), begin
    with pytest.raises(KeyboardInterrupt, match="episode 10: go on"):
        train_online(fresh(), runs[1], interrupted, *rest)
    again = fresh()
    resume(again, runs[1])
    train_online(again, runs[1], run_episodes, *rest)
    assert files(runs[0]) == files(runs[1])


def test_what_is_said_to_be_kept_is_on_disk(
    run_episodes: RunEpisodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped as the third checkpoint is written, whose row is there already."""
    written: list[Path] = []

    def write(path: Path, data: memoryview) -> None:
        written.append(path)
        if [p.name for p in written].count(FILE) == 3:
            raise KeyboardInterrupt
        path.write_bytes(data)

    monkeypatch.setattr(online, "write_bytes", write)
    algorithm = Ddpg(CONFIG, JUDGE, 0, (), REACH)
    with pytest.raises(KeyboardInterrupt, match="episode 10: go on"):
        train_online(algorithm, tmp_path, run_episodes, weighed, SCHEDULE)
    assert read_metrics(tmp_path)[-1]["episode"] == 15
    again = Ddpg(CONFIG, JUDGE, 0, (), REACH)
    resume(again, tmp_path)
    assert again.episodes == 10


def test_a_crash_between_log_and_checkpoint_leaves_no_double_rows(
    run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    train_online(
        Ddpg(replace(CONFIG, episodes=10), JUDGE, 0, (), REACH),
        tmp_path,
        run_episodes,
        weighed,
        SCHEDULE,
    )
    with RunLog(tmp_path, "episode", since=10) as log:
        log.add({"episode": 15, "success/all": 1.0, "return/all": 0.0})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"episode": 20, "succ')  # cut off
    again = Ddpg(replace(CONFIG, episodes=20), JUDGE, 0, (), REACH)
    resume(again, tmp_path, ("episodes",))
    train_online(again, tmp_path, run_episodes, weighed, SCHEDULE)
    assert [row["episode"] for row in read_metrics(tmp_path)] == [5, 10, 15, 20]


def test_damaged_or_cut_metrics_are_named(
    run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    algorithm = Ddpg(replace(CONFIG, episodes=10), JUDGE, 0, (), REACH)
    train_online(algorithm, tmp_path, run_episodes, weighed, SCHEDULE)
    path = tmp_path / "metrics.jsonl"
    whole = path.read_text()
    path.write_text(whole[:40] + "\n" + whole)
    with pytest.raises(CheckpointError, match=r"metrics\.jsonl is damaged"):
        RunLog(tmp_path, "episode", since=10)
    path.write_text(whole[: whole.index("\n") + 1])
    with pytest.raises(CheckpointError, match="ends at episode 5, the checkpoint"):
        RunLog(tmp_path, "episode", since=10)


def test_the_best_policy_is_kept(run_episodes: RunEpisodes, tmp_path: Path) -> None:
    """Of equals the first one."""
    rates = iter([0.2, 0.9, 0.9, 0.3, 0.9, 0.1])
    seen: list[np.ndarray] = []

    def rated(policy: LearnedPolicy) -> CurvePoint:
        seen.append(policy.act(np.ones(10)))
        return {"success/all": next(rates), "return/all": 0.0}

    train_online(
        Ddpg(CONFIG, JUDGE, 0, (), REACH), tmp_path, run_episodes, rated, SCHEDULE
    )
    np.testing.assert_array_equal(
        load_policy(tmp_path / BEST).act(np.ones(10)), seen[1]
    )
    np.testing.assert_array_equal(load_policy(tmp_path).act(np.ones(10)), seen[-1])


def test_metrics_name_what_a_user_looks_for(
    run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    train_online(
        Ddpg(CONFIG, JUDGE, 0, (), REACH), tmp_path, run_episodes, weighed, SCHEDULE
    )
    first, *_, last = read_metrics(tmp_path)
    assert first["updates"] == 0 and "loss/critic" not in first  # warming up
    assert {
        "train/return",
        "train/success",
        "train/alpha",
        "loss/critic",
        "loss/actor",
        "q/data",
        "q/policy",
        "action/saturation",
        "action/alpha",
    } < last.keys()
    assert last["env_steps"] == 4 * 30


def test_tensorboard_shows_what_the_metrics_say(
    run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    train_online(
        Ddpg(CONFIG, JUDGE, 0, (), REACH), tmp_path, run_episodes, weighed, SCHEDULE
    )
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    shown = [(event.step, event.value) for event in events.Scalars("success/all")]
    metrics = [
        (r["episode"], np.float32(r["success/all"])) for r in read_metrics(tmp_path)
    ]
    assert shown == metrics


def test_flat_is_no_better_success_rate_for_long_once_something_was_learnt() -> None:
    def rows(*rates: float) -> list[Row]:
        return [
            {"episode": 100 * (i + 1), "success/all": rate}
            for i, rate in enumerate(rates)
        ]

    assert not is_flat(rows(0.0, 0.0, 0.0, 0.0), 200)  # has not begun
    assert not is_flat(rows(0.5, 0.5, 0.5, 0.5), 200)  # may not have begun
    assert not is_flat(rows(0.4, 0.6, 0.6), 200)
    assert is_flat(rows(0.4, 0.6, 0.6, 0.5), 200)
    assert not is_flat(rows(0.4, 0.6, 0.7, 0.5), 200)
    assert not is_flat(rows(0.9, 0.9, 0.9, 0.9), 0)
    assert not is_flat([], 200)


@pytest.mark.parametrize("beside", [False, True])
def test_a_flat_run_ends_early(
    beside: bool, run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    def reached(policy: LearnedPolicy) -> CurvePoint:
        return {"success/all": 1.0, "return/all": 0.0}

    algorithm = Ddpg(CONFIG, JUDGE, 0, (), REACH)
    flat = replace(SCHEDULE, patience=10)
    with ThreadPoolExecutor(1) as thread:
        begin = (lambda policy: thread.submit(reached, policy)) if beside else None
        rest = flat, silent, (), begin
        train_online(algorithm, tmp_path, run_episodes, reached, *rest)
    assert algorithm.episodes == 15


@pytest.mark.parametrize("beside", [False, True])
def test_a_diverging_run_ends_with_its_last_checkpoint(
    beside: bool, begin: BeginEvaluation, run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    """A NaN among the rewards, as from a damaged dataset or a bug in a reward."""

    def poisoned(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
        for episode in run_episodes(policy, numbers):
            bad = episode.index == 22
            yield replace(episode, rewards=episode.rewards * (np.nan if bad else 1))

    algorithm = Ddpg(replace(CONFIG, hindsight=0, batch_size=256), JUDGE, 0, (), REACH)
    with pytest.raises(DivergedError, match=r"loss/critic is nan .* episode 20"):
        rest = weighed, SCHEDULE, silent, (), begin if beside else None
        train_online(algorithm, tmp_path, poisoned, *rest)
    assert np.isfinite(load_policy(tmp_path).act(np.ones(10))).all()
    assert [row["episode"] for row in read_metrics(tmp_path)] == [5, 10, 15, 20]


# --- Command line ------------------------------------------------------------

TINY = [
    *("--episodes", "8", "--warm-up", "12", "--updates-per-episode", "3"),
    *("--epoch", "4", "--evaluate-every", "1", "--curve-episodes", "2"),
    *("--eval-episodes", "2", "--capacity", "500", "--max-steps", "5"),
    *("--engine", "mujoco"),
]


@pytest.mark.slow
def test_training_does_not_depend_on_workers_or_interruptions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the real robot: one process, two processes, and stopped after an epoch."""
    monkeypatch.chdir(tmp_path)
    for name, workers in (("one", "1"), ("two", "2")):
        words = ["train", "ddpg-her", *TINY, "--out", name, "--workers", workers]
        assert main(words) == 0
    assert files(Path("one/0")) == files(Path("two/0"))
    last = read_metrics(Path("one/0"))[-1].keys()
    for kind in ("success", "return", "alpha"):
        assert {f"{kind}/{part}" for part in ("all", "forward", "backward")} <= last
    half = [word if word != "8" else "4" for word in TINY]
    assert main(["train", "ddpg-her", *half, "--out", "cut", "--workers", "1"]) == 0
    words = ["train", "ddpg-her", *TINY, "--out", "cut", "--workers", "1"]
    assert main([*words, "--resume"]) == 0
    theirs, ours = files(Path("one/0")), files(Path("cut/0"))
    assert theirs == ours
    for name in ("eval.json", "eval_best.json"):
        a, b = (
            json.loads(Path(f"{run}/0/{name}").read_text()) for run in ("one", "cut")
        )
        assert a["episodes"] == b["episodes"]
    capsys.readouterr()
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words, "--resume", "--noise", "0.3"]) == 2
    assert "noise = 0.1 (now 0.3)" in capsys.readouterr().err
    again = ["train", "ddpg-her", "--out", "cut", "--eval-episodes", "2", "--resume"]
    assert main([*again, "--noise", "0.3"]) == 2
    assert "with noise = 0.1 (now 0.3):" in capsys.readouterr().err  # nothing else
    assert main([*again, "--preset", "paper"]) == 2
    kept = Path("cut/0/eval.json")
    seen = kept.stat().st_mtime_ns
    assert main(again) == 0
    assert kept.stat().st_mtime_ns == seen  # nothing is evaluated twice
    assert main([*words, "--resume", "--eval-episodes", "1"]) == 0
    assert len(json.loads(kept.read_text())["episodes"]) == 1  # unless asked for
    capsys.readouterr()
    with only_here(Path("cut/0")):
        assert main([*words, "--resume"]) == 2
    assert "another process is writing cut/0" in capsys.readouterr().err
    fewer = [word if word != "8" else "4" for word in words]
    assert main([*fewer, "--resume"]) == 2
    assert "has 8 episodes already, --episodes is 4" in capsys.readouterr().err
    Path("cut/0/metrics.jsonl").rename("metrics.jsonl")
    assert main([*words, "--resume"]) == 1
    assert "cut/0" in capsys.readouterr().err
    Path("metrics.jsonl").rename("cut/0/metrics.jsonl")
    assert main(["eval", "cut"]) == 2
    assert "did you mean cut/0?" in capsys.readouterr().err
    for name in (FILE, BEST):
        same = Path("one/0", name).read_bytes() == Path("two/0", name).read_bytes()
        assert same, "whatever the name of the temporary file was"


def test_demonstrations_take_their_share_of_every_batch(
    make_episode: MakeEpisode,
) -> None:
    """None of it if one asks for that, or all of it."""
    others = [make_episode(100 + i, steps=5, success=i < 2) for i in range(6)]
    own = [make_episode(i, steps=5) for i in range(6)]
    theirs = {float(np.float32(x)) for e in others for x in e.states[:, 0]}
    for share in (0.0, 0.25, 1.0):
        config = replace(CONFIG, demonstration_share=share, batch_size=64)
        algorithm = Ddpg(config, JUDGE, 0, others, REACH)
        for episode in own:
            algorithm.observe(episode)
        for batch in algorithm._batches(3):
            shown = [float(x) in theirs for x in batch.observation[:, 0]]
            assert np.mean(shown) == share
        algorithm.learn(2)


@pytest.mark.slow
def test_demonstrations_are_of_the_same_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a run with them is resumed to the same bytes."""
    monkeypatch.chdir(tmp_path)
    words = ["collect", "pd", "--steps", "20", "--dataset", "./shown", "--workers", "1"]
    assert main([*words, "--engine", "mujoco"]) == 0
    words = ["train", "ddpg-her", "--demonstrations", "./shown", "--workers", "1"]
    assert main([*words, "--task", "SmoothReach-v0"]) == 2
    assert "is of Reach-v0, expected SmoothReach-v0" in capsys.readouterr().err
    half = [word if word != "8" else "4" for word in TINY]
    assert main([*words, *TINY, "--out", "whole"]) == 0
    assert main([*words, *half, "--out", "cut"]) == 0
    assert main([*words, *TINY, "--out", "cut", "--resume"]) == 0
    assert files(Path("whole/0")) == files(Path("cut/0"))


def test_demonstrations_tell_all_that_is_learnt_from() -> None:
    shown, training = load_dataset("good-5k"), training_of("ddpg-her")
    other = several_layouts(shown.arrays)[UNUSUAL]
    with pytest.raises(UsageError, match="layout"):
        check_training(training, replace(shown, arrays=other), {})
    info = shown.arrays.info | {"d_mm": np.full(len(shown.arrays.rewards), np.nan)}
    lacking = replace(shown, arrays=replace(shown.arrays, info=info))
    with pytest.raises(UsageError, match=r"lacks d_mm.* take ddpg, without hindsight"):
        check_training(training, lacking, {})
    check_training(training_of("ddpg"), lacking, {})


def test_a_share_of_less_than_one_demonstration_is_refused() -> None:
    shown, training = load_dataset("good-5k"), training_of("ddpg-her")
    for share, refused in ((0.0, True), (0.007, True), (0.009, False)):
        few = replace(training.config, batch_size=64, demonstration_share=share)
        case = partial(check_training, replace(training, config=few), shown, {})
        if refused:
            with pytest.raises(UsageError, match="no transition of a batch is"):
                case()
        else:
            case()


@pytest.mark.slow
def test_the_agents_of_maddpg_act_in_the_parallel_environment(tmp_path: Path) -> None:
    from marl_mm.envs import parallel_env

    words = ["train", "maddpg-her", *TINY, "--out", str(tmp_path), "--workers", "1"]
    assert main(words) == 0
    policy = load_policy(tmp_path / "0")
    env = parallel_env("Reach-v0")
    observations, _ = env.reset(seed=0)
    joint = policy.act(env.state())
    actions = policy.act_agents(observations)
    np.testing.assert_array_equal(np.concatenate(list(actions.values())), joint)
    env.step(actions)
    env.close()


def test_usage_of_train_online(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for words, message in (
        (["ddpg", "--hindsight", "4"], "--hindsight is 4 with ddpg: use ddpg-her"),
        (["ddpg", "--preset", "mine"], "--preset is 'mine', expected one of tuned"),
        (["ddpg", "--task", "Fly-v0"], "unknown task 'Fly-v0'"),
        (["ddpg", "--noise", "-1"], "noise is -1.0, expected >= 0"),
        (["ddpg", "--epoch", "0"], "epoch is 0, expected >= 1"),
        (
            ["ddpg", "--capacity", "20", "--warm-up", "9"],
            "--capacity is 20, expected at least an episode's 25 steps",
        ),
        (["ddpg", "--seeds", "1", "1"], "--seeds is 1 1, expected each seed once"),
        (["ddpg", "--resume", "--overwrite"], "contradict each other"),
        ([], "see marl-mm train --help"),
        (["ddpg", "--resume"], "no run in runs/ddpg to resume"),
        (["ddpg", "--demonstrations", "marl_mm/reach/none-v0"], "none-v0"),
        (["ddpg", "--curve-episodes", "0"], "--curve-episodes is 0"),
    ):
        assert main(["train", *words]) == 2, words
        assert message in capsys.readouterr().err
    assert not Path("runs").exists()


def test_the_paper_preset_shows_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "ddpg-her", "--preset", "paper", "--help"])
    assert "(default: 5000)" in " ".join(capsys.readouterr().out.split())


# --- The agent that ships ----------------------------------------------------


def test_the_pretrained_agent_is_small_whole_and_acts() -> None:
    from marl_mm.algorithms.pretrained import FOLDER

    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000
    assert {path.name for path in FOLDER.iterdir()} >= {
        "policy.safetensors",
        "config.json",
        "metrics.jsonl",
        "eval.json",
    }
    evaluation = json.loads((FOLDER / "eval.json").read_text())
    assert evaluation["success_rate"] >= 0.95
    config = json.loads((FOLDER / "config.json").read_text())
    assert config["algorithm"] == "ddpg-her" and "seed" in config
    hyper = json.loads(json.dumps(as_record(preset("ddpg-her"))))
    assert {name: config[name] for name in hyper} == hyper  # what train does today
    action = load_pretrained().act(np.zeros(10))
    assert action.shape == (4,) and np.isfinite(action).all()
    for name in ("pretrained", FOLDER):
        np.testing.assert_array_equal(load_policy(name).act(np.zeros(10)), action)
    split = split_action(action, REACH)
    np.testing.assert_array_equal(split["end_effector"], action[:3])
    np.testing.assert_array_equal(split["balance"], action[3:])


def test_a_shipped_run_acts_as_its_best_policy(
    run_episodes: RunEpisodes, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    algorithm = Ddpg(CONFIG, JUDGE, 0, (), REACH)
    (run / "config.json").write_text(json.dumps({"task": "Reach-v0"}))
    (run / "eval_best.json").write_text("{}")
    train_online(algorithm, run, run_episodes, weighed, SCHEDULE)
    ship(run, tmp_path / "shipped")
    shipped, best = load_pretrained(tmp_path / "shipped"), load_policy(run / BEST)
    for state in np.random.default_rng(0).normal(size=(20, 10)):
        np.testing.assert_array_equal(shipped.act(state), best.act(state))
    weights = tmp_path / "shipped" / "policy.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="damaged"):
        load_pretrained(tmp_path / "shipped")
