"""Disturbances: they change what they say, goal by goal, and nothing at strength 0."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.commands import eval as command
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.cross_play import CrossPlay
from marl_mm.eval.disturbances import (
    Disturbed,
    Dropped,
    Frozen,
    Late,
    Noisy,
    disturbed,
)
from marl_mm.eval.evaluate import Evaluation, Setup
from marl_mm.eval.intervals import paired_interval
from marl_mm.eval.suite import ROBUSTNESS, conditions
from marl_mm.layout import Layout
from marl_mm.progress import Advance, Bar
from marl_mm.sim.config import is_installed

NOTHING: dict[type[Disturbed], float] = {
    Late: 0,
    Dropped: 0.0,
    Frozen: math.inf,
    Noisy: 0.0,
}
"""Strengths at which nothing is disturbed."""

FEW: dict[str, Any] = {"episodes": 2, "max_steps": 3, "engine": "mujoco"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs that have learnt next to nothing, of actors that draw noise."""
    folder = tmp_path_factory.mktemp("runs")
    few: dict[str, Any] = {"hidden": (16, 16), "batch_size": 32, "updates": 4}
    few |= {"eval_episodes": 2, "curve_episodes": 1, "max_steps": 2}
    for name in ("flow-bc", "ma-flow-bc", "mabc"):
        marl_mm.train(name, "good-5k", out=folder / name, **few)
    return {path.name: path / "0" for path in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flow-bc", "ma-flow-bc"])
@pytest.mark.parametrize("kind", NOTHING)
def test_nothing_is_disturbed_at_strength_nothing(
    runs: dict[str, Path], name: str, kind: type[Disturbed]
) -> None:
    """To the bit, and of actors that draw noise, too."""
    policy = marl_mm.load_policy(runs[name])
    setup = Setup(
        "Reach-v0", {"max_steps": 3, "simulation": {"engine": "mujoco"}}, 2, 0
    )
    spread = np.ones(len(setup.made.layout.state))
    with setup.rollouts() as rollouts:
        clean = setup.run(rollouts, policy)
        for agent in setup.made.layout.agents:
            same = disturbed(kind, policy, agent, NOTHING[kind], spread)
            assert setup.run(rollouts, same).rows == clean.rows


# --- The suite ---------------------------------------------------------------


@pytest.mark.parametrize("task", ["Reach-v0", "Bar-v0", "Course-v0", "MovingReach-v0"])
def test_every_agent_of_every_task_is_disturbed_in_three_strengths(task: str) -> None:
    listed, left_out = conditions(task, {}, list(ROBUSTNESS))
    for name, what in ROBUSTNESS.items():
        mine = [each for each in listed if each.disturbance == name]
        assert len(what.strengths) == (1 if name == "engine" else 3)
        if isinstance(what.how, type):
            team = [agent.name for agent in make_task(task).layout.team]
            assert [each.agent for each in mine] == [n for n in team for _ in range(3)]
        else:
            assert len(mine) == len(what.strengths) or name in left_out


def test_what_does_not_apply_is_named() -> None:
    _, left_out = conditions("Reach-v0", {}, list(ROBUSTNESS))
    assert left_out["payload"] == "the task has nothing to carry"
    assert "no block" in left_out["pad friction"]
    _, left_out = conditions("CarryReach-v0", {}, list(ROBUSTNESS))
    assert left_out.keys() <= {"engine"}
    if not is_installed("bullet"):
        assert "pybullet, which is not installed" in left_out["engine"]


def test_payload_friction_and_engine_change_what_they_say() -> None:
    overrides = {"max_steps": 3, "simulation": {"engine": "mujoco"}}
    changed = {
        (each.disturbance, each.strength): make_task("CarryReach-v0", each.overrides)
        for each in conditions("CarryReach-v0", overrides, list(ROBUSTNESS))[0]
    }
    clean: Any = make_task("CarryReach-v0", overrides)
    heavy: Any = changed["payload", 2.0]
    slippery: Any = changed["pad friction", 0.5]
    assert heavy.load.mass == (6.0, 6.0) and heavy.load.edge == clean.load.edge
    assert slippery.load.friction == (0.3, 0.3)
    assert changed["wheel friction", 0.05].simulation.wheel_friction == 0.05
    assert changed["wheel friction", 0.05].simulation.engine == "mujoco"
    assert all(task.max_steps == 3 for task in changed.values())
    if is_installed("bullet"):
        assert changed["engine", "other"].simulation.engine == "bullet"
    bar: Any = conditions("Bar-v0", {}, ["payload"])[0][0].overrides
    assert bar == {"bar_mass": 2.5}


@pytest.mark.slow
def test_the_world_does_otherwise_with_another_payload_friction_or_engine() -> None:
    names = ("payload", "pad friction", "wheel friction", "engine")
    few = FEW | {"max_steps": 6, "task": "CarryReach-v0"}
    result = marl_mm.robustness("scripted", disturbances=names, **few)
    by_name = {(c.disturbance, c.strength): e for c, e in result.disturbed.items()}
    strongest = [
        by_name["payload", 2.0],
        by_name["pad friction", 0.1],
        by_name["wheel friction", 0.02],
        *([by_name["engine", "other"]] if is_installed("bullet") else []),
    ]
    for evaluation in strongest:
        pairs = list(zip(evaluation.rows, result.clean.rows, strict=True))
        assert all(row["goal"] == other["goal"] for row, other in pairs)
        assert any(row["return"] != other["return"] for row, other in pairs)
        assert evaluation.overrides != result.clean.overrides
    assert "dropped" in str(strongest[1].summary["all"]["failures"])
    if is_installed("bullet"):
        assert strongest[-1].engine.startswith("bullet")


def test_noise_has_the_spread_that_is_asked_for() -> None:
    few: dict[str, Any] = {**FEW, "disturbances": "noisy"}
    entries = len(make_task("Reach-v0").layout.state)
    still = marl_mm.robustness("pd", spread=[0.0] * entries, **few)
    assert len(still.disturbed) == 6
    for result in still.disturbed.values():
        assert result.rows == still.clean.rows
    shaken = marl_mm.robustness("pd", spread=[1.0] * entries, **few)
    assert any(one.rows != shaken.clean.rows for one in shaken.disturbed.values())
    odds: list[Any] = [[1.0], [math.nan] * entries, [-1.0] * entries, "much"]
    for odd in odds:
        with pytest.raises(UsageError, match=f"expected {entries} numbers >= 0"):
            marl_mm.robustness("pd", spread=odd, **few)


@pytest.mark.slow
def test_results_do_not_depend_on_workers_or_on_what_else_is_run(
    runs: dict[str, Path],
) -> None:
    names = ("dropped", "noisy")
    few = FEW | {"episodes": 3}
    one = marl_mm.robustness(runs["flow-bc"], disturbances=names, **few)
    two = marl_mm.robustness(runs["flow-bc"], disturbances=names, workers=2, **few)
    assert one.to_json() == two.to_json()
    noisy = marl_mm.robustness(runs["flow-bc"], disturbances=("noisy",), **few)
    for condition, evaluation in noisy.disturbed.items():
        assert one.disturbed[condition].rows == evaluation.rows
    assert one.clean.rows == marl_mm.evaluate(runs["flow-bc"], **few).rows


@pytest.mark.slow
def test_differences_are_paired_and_shown(runs: dict[str, Path]) -> None:
    result = marl_mm.robustness(runs["mabc"], disturbances="late", **FEW)
    assert len(result.disturbed) == 2 * 3
    head, *lines = result.table_rows()
    assert head[0] == "clean" and lines[4][:3] == ("late", "balance", "2 steps")
    for condition, line in zip(result.disturbed, lines, strict=True):
        change, (low, high) = result.difference(condition)
        assert low < change < high
        assert line[4] == f"{100 * change:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"
    assert "<table>" in result._repr_html_() and "mujoco" in result.note
    (record, *_) = result.to_json()["disturbed"]
    first, *_ = result.disturbed.values()
    assert Evaluation.from_json(record).rows == first.rows


# --- Cross-play --------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flow-bc", "ma-flow-bc"])
def test_cross_play_with_itself_is_the_clean_run(
    runs: dict[str, Path], name: str
) -> None:
    clean = marl_mm.evaluate(runs[name], **FEW)
    result = marl_mm.cross_play([runs[name], runs[name]], **FEW)
    assert len(result.evaluations) == 4
    for evaluation in result.evaluations.values():
        assert evaluation.rows == clean.rows


@pytest.mark.slow
def test_the_matrix_has_a_row_per_agent_and_run(runs: dict[str, Path]) -> None:
    names = [runs["mabc"], runs["flow-bc"], "pd"]
    result = marl_mm.cross_play(names, **FEW)
    assert len(result.evaluations) == 3 + 6, "teams of the same agents are run once"
    assert result.header == (
        "agent",
        "of run",
        *(f"from {n} %, change [95 %]" for n in "123"),
    )
    lines = result.table_rows()
    assert [line[0] for line in lines] == ["end_effector"] * 3 + ["balance"] * 3
    reached, of_other = (text.split(",")[0] for text in (lines[0][3], lines[4][2]))
    assert reached == of_other, "the second's hand beside the first's balance"
    own, mixed = (
        [row["success"] for row in result.evaluations[team].rows]
        for team in ((0, 0), (2, 0))
    )
    change, bounds = result.difference("end_effector", 0, 2)
    assert change == pytest.approx(np.mean(mixed) - np.mean(own))
    assert bounds == paired_interval(mixed, own)
    differences = result.to_json()["differences"]
    assert len(differences) == 2 * 6 and differences[1]["difference"] == change
    assert "from 3" in result.markdown() and "<table>" in result._repr_html_()
    for agent, other in (("end-effector", 1), ("balance", 5)):
        with pytest.raises(
            UsageError, match=r"no team of .*, expected end_effector or"
        ):
            result.difference(agent, 0, other)


class Lists:
    """A policy whose actions are lists."""

    name = "lists"

    def describe(self) -> dict[str, Any]:
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        pass

    def act(self, state: np.ndarray) -> Any:
        return [0.5, 0.0, 0.0, 1.0]


def test_actions_may_be_lists() -> None:
    result = marl_mm.robustness(Lists(), disturbances=["late"], **FEW)
    assert result.clean.rows and len(result.disturbed) == 6
    assert len(marl_mm.cross_play([Lists(), "pd"], **FEW).evaluations) == 4


def test_collectors_among_partners_have_their_settings() -> None:
    configs = [None, PdConfig(alpha=0.0)], [None, PdConfig(alpha=1.0)]
    still, moving = (
        marl_mm.cross_play(["pretrained", "pd"], configs=each, **FEW).evaluations
        for each in configs
    )
    assert still[0, 0].rows == moving[0, 0].rows
    assert still[1, 1].rows != moving[1, 1].rows


# --- The command -------------------------------------------------------------


SHORT = ["--episodes", "2", "--max-steps", "2", "--engine", "mujoco", "--workers", "1"]


@pytest.mark.slow
def test_the_command_writes_what_python_returns(
    runs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, run = tmp_path / "out.json", str(runs["mabc"])
    words = ["eval", run, "--suite", "robustness", "--partners", "pd", *SHORT]
    assert main([*words, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "clean" in text and "payload (the task has nothing to carry)" in text
    assert f"1: {run}" in text
    disturbed_, crossed = json.loads(out.read_text())
    few = FEW | {"max_steps": 2}
    result = marl_mm.robustness(run, **few)
    assert (
        disturbed_["disturbed"] == json.loads(json.dumps(result.to_json()))["disturbed"]
    )
    assert [team["agents"]["balance"] for team in crossed["teams"]] == [run, "pd"] * 2
    assert main([*words, "--out", str(out)]) == 2  # it exists


@pytest.mark.slow
def test_ctrl_c_leaves_what_is_finished(
    runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left: Iterator[int] = iter(())

    @contextmanager
    def bars() -> Iterator[Bar]:
        def bar(label: str, total: int) -> Advance:
            def advance(done: int, note: str) -> None:
                if next(left, None) is None:
                    raise KeyboardInterrupt

            return advance

        yield bar

    monkeypatch.setattr(command, "progress_bars", bars)
    out = tmp_path / "out.json"
    left = iter(range(5))
    words = ["eval", str(runs["mabc"]), "--suite", "robustness", *SHORT]
    assert main([*words, "--out", str(out)]) == 130
    (record,) = json.loads(out.read_text())
    assert [len(each["episodes"]) for each in record["disturbed"]] == [2]
    left = iter(range(5))
    words = ["eval", "pd", "random", "pd", *SHORT, "--overwrite"]
    assert main([*words, "--out", str(out)]) == 130
    assert [each["policy"] for each in json.loads(out.read_text())] == ["pd", "random"]
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["pd", "--suite", "fly"], "--suite"),
        (["pd", "--partners", "nobody"], "no policy 'nobody'"),
        (["pretrained", "--task", "Grasp-v0", "--partners", "pd"], "another layout"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", *words, *SHORT]) == 2
    error = capsys.readouterr().err
    assert complaint in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (
            lambda: marl_mm.robustness("pd", disturbances=["dizzy"], **FEW),
            "no disturbance 'dizzy', expected some of late, dropped",
        ),
        (
            lambda: marl_mm.robustness("pd", disturbances=["late", "late"], **FEW),
            "disturbances are late late, expected each once",
        ),
        (lambda: marl_mm.cross_play(["pd"], **FEW), "expected 2 or more"),
        (lambda: marl_mm.cross_play("pd", **FEW), "'pd' are no policies, expected 2"),
        (
            lambda: marl_mm.cross_play(["pd", "random"], configs=cast(Any, 3), **FEW),
            "`configs` is 3, expected a list",
        ),
        (lambda: marl_mm.robustness("pd", episodes=0), "`episodes` is 0"),
    ],
)
def test_mistakes_in_python_are_usage_errors(
    call: Callable[[], Any], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        call()


def test_a_difference_is_what_another_runs_agent_gains() -> None:
    """By hand: run 0 reaches nothing, and one of two goals with the hand of run 1."""

    def evaluation(*reached: bool) -> Evaluation:
        rows: Any = [
            {"index": n, "seed": n, "goal": [0.5], "success": each, "return": 0.0}
            | {"steps": 1}
            for n, each in enumerate(reached)
        ]
        return Evaluation("", {}, "Reach-v0", {}, 0, rows)

    teams: dict[tuple[int, ...], Evaluation] = {
        (0, 0): evaluation(False, False),
        (1, 0): evaluation(True, False),
    }
    result = CrossPlay(("a", "b"), ("hand", "balance"), teams)
    assert result.difference("hand", 0, 1)[0] == 0.5
    (found,) = result.to_json()["differences"]
    assert (found["agent"], found["of"], found["from"]) == ("hand", "a", "b")
    assert found["difference"] == 0.5


class Held(Lists):
    """A policy that sets every entry of its action to one number."""

    def __init__(self, number: float) -> None:
        self.number = number

    def describe(self) -> dict[str, Any]:
        return {"number": self.number}

    def act(self, state: np.ndarray) -> Any:
        return np.full(4, self.number, np.float32)


def test_a_team_has_another_runs_agent_beside_its_own() -> None:
    """Alpha is of the balance agent, and its mean is in every row."""
    held = Held(0.25), Held(0.75)
    found = marl_mm.cross_play(held, **FEW).evaluations
    alphas = {team: each.rows[0]["alpha"] for team, each in found.items()}
    expected = {(i, j): held[j].number for i in range(2) for j in range(2)}
    assert alphas == pytest.approx(expected)


def test_noise_has_the_spread_of_all_states_of_the_clean_run() -> None:
    """Of every episode, its last state too, where no other spread is given."""
    few: dict[str, Any] = {**FEW, "disturbances": "noisy"}
    usual = marl_mm.robustness("pd", **few)
    states: list[np.ndarray] = []
    setup = Setup("Reach-v0", usual.clean.overrides, FEW["episodes"], 0)
    with setup.rollouts() as rollouts:
        clean = setup.run(rollouts, PdPolicy(PdConfig()), states=states)
    assert clean.rows == usual.clean.rows
    given = marl_mm.robustness("pd", spread=np.concatenate(states).std(axis=0), **few)
    for condition, evaluation in usual.disturbed.items():
        assert given.disturbed[condition].rows == evaluation.rows
