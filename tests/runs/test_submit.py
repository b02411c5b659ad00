"""Submissions: the round trip is equal to the bit, and what was changed is found."""

import json
import re
import shutil
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.envs.registry import TASKS
from marl_mm.errors import (
    MarlMmError,
    OutputExistsError,
    SubmissionError,
    UsageError,
)
from marl_mm.eval.intervals import interval_of_mean, wider_interval
from marl_mm.eval.metrics import METRICS, Metric
from marl_mm.runs import submission_checks
from marl_mm.runs import verify as verifying
from marl_mm.runs.comparison import beyond_chance, differing
from marl_mm.runs.folder import CONFIG, EVALUATION
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.submission import EPISODES, MANIFEST, Scored, scored
from marl_mm.runs.submission_checks import read_submission
from marl_mm.runs.verification import stands, verification_file
from tests.conftest import MakeEpisode
from tests.runs.tampering import (
    CLAIMS,
    TAMPERING,
    UNSEALED,
    edit,
    in_each,
    manifest,
    row,
    seal_again,
    weights,
)

GOALS = 6

pytestmark = pytest.mark.slow

TRAINED: dict[str, Any] = {
    "hidden": (32, 32),
    "batch_size": 64,
    "eval_episodes": 2,
    "curve_episodes": 1,
    "engine": "mujoco",
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds that reach most goals, and two that reach none."""
    folder = tmp_path_factory.mktemp("runs")
    for name, updates in (("long", 400), ("short", 1)):
        marl_mm.train(
            "mabc",
            "good-5k",
            out=folder / name,
            seeds=(0, 1),
            updates=updates,
            curve_every=updates,
            **TRAINED,
        )
    return folder


@pytest.fixture(scope="module")
def honest(runs: Path) -> Path:
    folder = runs / "honest"
    marl_mm.submit([runs / "long/1", runs / "long/0"], out=folder, episodes=GOALS)
    return folder


@pytest.fixture
def copy(honest: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(honest, tmp_path / "copy"))


def test_scoring_again_is_equal_to_the_bit(copy: Path) -> None:
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    verification_file(copy).write_text("[]")  # a damaged one is replaced
    result = marl_mm.verify(copy, seed=3)
    assert (result.verdict, result.differences) == ("equal to the bit", ())
    assert result.equal == result.scored == result.episodes == 2 * GOALS
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before
    kept = json.loads(verification_file(copy).read_text())
    assert kept["fingerprint"] == result.fingerprint
    assert marl_mm.verify(copy, seed=np.int64(3)).equal == result.equal  # type: ignore[arg-type]


def test_what_submit_returned_is_looked_at_as_its_files_are_now(copy: Path) -> None:
    before = read_submission(copy)
    with (copy / "0/policy.safetensors").open("ab") as file:
        file.write(b"x")
    for look in (marl_mm.verify, lambda it: marl_mm.board(it, out=copy / "board")):
        with pytest.raises(SubmissionError, match=r"policy\.safetensors' is not the"):
            look(before)


def test_a_submitted_policy_has_its_own_name_and_is_not_written_into(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert marl_mm.load_policy(copy / "0").name == "mabc"
    monkeypatch.chdir(copy.parent)
    assert marl_mm.export(copy / "0")["file"] == "policy.ts"
    monkeypatch.chdir(copy)
    assert marl_mm.verify(".", minutes=1e-6).verdict == "equal to the bit"
    assert verification_file(copy).exists()


def test_a_folder_in_the_verdicts_place_is_refused_before_any_work(copy: Path) -> None:
    verification_file(copy).mkdir()
    with pytest.raises(UsageError, match="is a folder"):
        marl_mm.verify(copy)


def test_a_submission_follows_from_its_runs(honest: Path, runs: Path) -> None:
    """Twice the same bytes, no path of this machine, the weights of the checkpoints."""
    again = runs / "again"
    made = marl_mm.submit([runs / "long/0", runs / "long/1"], out=again, episodes=GOALS)
    for path in (p for p in honest.rglob("*") if p.is_file()):
        assert (again / path.relative_to(honest)).read_bytes() == path.read_bytes()
        assert str(runs).encode() not in path.read_bytes()
        assert str(Path(marl_mm.__file__).parent).encode() not in path.read_bytes()
    own = marl_mm.load_run(runs / "long/0")
    assert made.runs[0].policy.fingerprint == own.policy.fingerprint
    assert [row["return"] for row in own.evaluated.rows] == [
        each.row["return"] for each in made.runs[0].episodes[:2]
    ]
    assert made.manifest["dataset"].keys() == {"id", "fingerprint", "data_sha256"}


def test_intervals_of_claims_count_goals_and_seeds(honest: Path) -> None:
    made = read_submission(honest)
    claims, rates = made.manifest["claims"], made.scores("success").mean(axis=1)
    assert claims["success_interval"] == [*wider_interval(rates.tolist(), GOALS)]
    assert claims["return_interval"] == [*interval_of_mean(made.scores("return"))]


def test_a_hash_is_of_states_actions_and_rewards(make_episode: MakeEpisode) -> None:
    episode = make_episode(0)
    others = (
        replace(episode, **{name: getattr(episode, name) + 1})
        for name in ("states", "actions", "rewards")
    )
    assert len({scored(each).sha256 for each in (episode, *others)}) == 4


def test_a_start_goes_by_its_name_and_data_by_a_hash_while_they_are_the_same(
    runs: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(runs / "short/0", tmp_path / "run")

    def change(values: Any) -> None:
        values |= {"start": str(tmp_path / "first"), "max_steps": 3}
        values["dataset"]["fingerprint"] = "0" * 16

    edit(run / CONFIG, change)
    made = marl_mm.submit(run, out=tmp_path / "out", episodes=1)
    assert made.runs[0].config.settings["start"] == "first"
    assert made.manifest["dataset"].keys() == {"id", "fingerprint"}
    assert made.task.max_steps == made.runs[0].episodes[0].row["steps"] == 3


def test_minutes_are_minutes_and_the_seed_is_drawn(
    honest: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[float, int]] = []

    def stop(_: Any, end: float, seed: int, *others: Any) -> None:
        asked.append((end - time.monotonic(), seed))
        raise KeyboardInterrupt

    monkeypatch.setattr(verifying, "_scored_again", stop)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            marl_mm.verify(honest, minutes=10)
    assert all(590 < left <= 600 for left, _ in asked)
    assert asked[0][1] != asked[1][1]


def test_little_time_scores_a_part_that_a_seed_repeats(
    runs: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "many"
    made = marl_mm.submit([runs / "short/0"], out=folder, episodes=12)
    results = [marl_mm.verify(folder, minutes=1e-6, seed=1) for _ in range(2)]
    assert [each.scored for each in results] == [1, 1]
    assert results[0].success == results[1].success
    assert results[0].verdict == "equal to the bit"
    assert "time was up after 1 of 12 episodes" in results[0].notes[0]
    assert results[0].episodes == made.scores("success").size == 12


def test_a_verification_keeps_one_that_was_written_meanwhile(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    score, found = verifying._scored_again, '"not equal"'

    def beside_another(*given: Any) -> Any:
        record = json.dumps(asdict(replace(whole, verdict="not equal")))
        verification_file(copy).write_text(record)
        return score(*given)

    whole = marl_mm.verify(copy)
    monkeypatch.setattr(verifying, "_scored_again", beside_another)
    assert marl_mm.verify(copy, minutes=1e-6).verdict == "equal to the bit"
    assert found in verification_file(copy).read_text()


def test_a_short_verification_replaces_no_longer_one(copy: Path) -> None:
    """Neither "not equal", which it may miss, nor one of more episodes."""
    whole = marl_mm.verify(copy)
    short = marl_mm.verify(copy, minutes=1e-6, seed=0)
    assert (whole.scored, short.scored) == (2 * GOALS, 2)
    assert json.loads(verification_file(copy).read_text())["scored"] == 2 * GOALS
    row(0, success=not whole_row(copy, 0)["success"])(copy)
    seal_again(copy)
    found = marl_mm.verify(copy)
    assert found.verdict == "not equal"
    assert found.claimed != found.success == whole.success == whole.claimed
    others = (marl_mm.verify(copy, minutes=1e-6, seed=seed) for seed in range(20))
    missed = next(each for each in others if each.verdict != "not equal")
    assert "kept on record: not equal, 12 scored before" in missed.notes
    assert json.loads(verification_file(copy).read_text())["verdict"] == "not equal"
    row(0, success=not whole_row(copy, 0)["success"])(copy)
    seal_again(copy)
    assert marl_mm.verify(copy).verdict == "equal to the bit"


def test_a_verdict_gives_way_to_one_that_knows_more(honest: Path) -> None:
    whole = marl_mm.verify(honest)
    part = replace(whole, scored=1)
    false, partly = (replace(each, verdict="not equal") for each in (whole, part))
    kept = (whole, part), (false, part), (partly, part)
    replaced = (
        *((part, part), (part, whole), (whole, whole), (false, whole)),
        *((whole, partly), (whole, false), (partly, whole)),
    )
    assert all(stands(asdict(earlier), result) for earlier, result in kept)
    assert not any(stands(asdict(earlier), result) for earlier, result in replaced)


def whole_row(folder: Path, number: int) -> Any:
    return json.loads((folder / "0" / EVALUATION).read_text())["episodes"][number]


def test_seeds_that_act_alike_are_named(copy: Path) -> None:
    """In all of their first actions; one of these may be the same."""
    own, other = (
        json.loads((copy / seed / EPISODES).read_text())["first_action"]
        for seed in "01"
    )
    partly = [[*a[:1], *b[1:]] for a, b in zip(own, other, strict=True)]
    for first, alike in ((partly, False), (own, True)):
        edit(copy / "1" / EPISODES, partial(dict.update, first_action=first))
        seal_again(copy)
        notes = "; ".join(marl_mm.verify(copy, minutes=1e-6).notes)
        assert ("seeds 0 and 1 begin alike for 6 of 6 goals" in notes) == alike


def test_versions_machine_and_data_that_are_others_are_noted(copy: Path) -> None:
    name = "quiet-zone-noisy"
    recipe = {"recipe": name, "recipe_sha256": RECIPES.get(name).fingerprint}
    in_each(CONFIG, lambda v: v["dataset"].update(recipe))(copy)
    manifest(lambda v: v["packages"].update(numpy="1.0"))(copy)
    manifest(lambda v: v["machine"].update(processor="Z80"))(copy)
    seal_again(copy)
    result = marl_mm.verify(copy, minutes=1e-6)
    assert result.verdict == "equal to the bit"
    notes = "; ".join(result.notes)
    assert f"submitted with numpy 1.0 (here {np.__version__})" in notes
    assert "processor Z80 (here " in notes
    assert "the dataset is not the one on record" in notes


def test_a_value_that_is_the_tasks_own_makes_no_section(
    honest: Path, copy: Path, tmp_path: Path
) -> None:
    in_each(EVALUATION, lambda v: v["overrides"].update(max_steps=25))(copy)
    seal_again(copy)
    sections = marl_mm.board([honest, copy], out=tmp_path / "board").sections
    assert [len(section) for section in sections] == [2]


def test_a_metric_of_ones_own_may_be_nan_and_unknown_elsewhere(
    runs: Path, tmp_path: Path, registries: None
) -> None:
    METRICS.add("mine", Metric(about="Nothing.", value=lambda episode: float("nan")))
    made = marl_mm.submit(runs / "long/0", out=tmp_path / "out", episodes=2)
    assert marl_mm.verify(made).verdict == "equal to the bit"
    before = marl_mm.submit(runs / "long/1", out=tmp_path / "before", episodes=1)
    for path in before.folder.rglob(EVALUATION):  # from where there was none
        edit(path, lambda v: [each.pop("mine") for each in v["episodes"]])
    seal_again(before.folder)
    assert marl_mm.verify(before).verdict == "equal to the bit"
    METRICS._things.pop("mine")
    result = marl_mm.verify(made)
    assert result.verdict == "equal to the bit"
    assert "not checked, as nothing here measures it: mine" in result.notes


# --- Tampering ---------------------------------------------------------------


def said_of(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The only line on stderr about a submission that is refused."""
    assert main(["verify", str(folder), "--workers", "1"]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in lines if line.startswith("marl-mm: ")]) == 1
    return lines[-1]


@pytest.mark.parametrize("name", [*TAMPERING, *CLAIMS])
def test_tampering_is_found_although_all_hashes_are_recomputed(
    name: str, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, said = (TAMPERING | CLAIMS)[name]
    change(copy)
    seal_again(copy, claims=name in TAMPERING)
    assert re.search(said, said_of(copy, capsys))


@pytest.mark.parametrize("name", [*TAMPERING, *CLAIMS, *UNSEALED])
def test_tampering_is_found_by_the_hashes_alone(name: str, copy: Path) -> None:
    change, _ = (TAMPERING | CLAIMS | UNSEALED)[name]
    change(copy)
    with pytest.raises(MarlMmError):
        marl_mm.board([copy], out=copy.parent / "board")


def test_a_task_of_another_plug_in_is_refused(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TASKS._origins, "Reach-v0", "tests.runs.tampering")
    with pytest.raises(SubmissionError, match=r"with another tests\.runs\.tampering"):
        read_submission(copy)


def test_another_processors_last_bits_are_equal_within_intervals(copy: Path) -> None:
    """Such as products in another order: weights that differ by 1e-7."""
    for seed in "01":
        weights(lambda v: v * (1 + 2e-7), last=False, seed=seed)(copy)
    seal_again(copy)
    result = marl_mm.verify(copy)
    assert (result.verdict, result.differences) == ("equal within intervals", ())
    assert result.equal == 0
    assert any("be wary of small differences" in note for note in result.notes)


def test_a_machine_that_repeats_one_seed_has_to_repeat_the_other(copy: Path) -> None:
    weights(lambda v: v * (1 + 2e-7), last=False)(copy)
    seal_again(copy)
    result = marl_mm.verify(copy)
    assert result.verdict == "not equal" and result.equal == GOALS
    assert "6 of all 12 are equal to the bit on this machine" in result.differences[0]


def test_a_tenth_of_equal_episodes_tells_the_machine(honest: Path) -> None:
    made = read_submission(honest)

    def found(equal: int) -> list[str]:
        first, second = (
            [(each, replace(each, sha256="")) for each in run.episodes]
            for run in made.runs
        )
        first[:equal] = [(each, each) for each, _ in first[:equal]]
        return [*differing(made, [first, second])]

    assert found(1) == []
    assert len(found(2)) == 2 and "2 of all 12 are equal to the bit" in found(2)[1]


@pytest.mark.parametrize(
    ("more", "flipped", "said"),
    [
        (np.full(200, 0.006), 0, "return: claimed 0.006, scored again 0.000"),
        (np.full(200, 0.004), 0, ""),
        (0.16 + np.resize([-1.0, 1.0], 200), 0, ""),  # 2.3 standard errors
        (0.20 + np.resize([-1.0, 1.0], 200), 0, "return: claimed"),  # 2.8 of them
        (np.zeros(200), 10, ""),
        (np.zeros(200), 11, "success: 11 of 200 goals have another outcome"),
    ],
)
def test_what_is_beyond_chance(more: np.ndarray, flipped: int, said: str) -> None:
    def rows(returns: np.ndarray, parity: int) -> list[Scored]:
        """As many succeed in one as in the other: the rate is the same."""
        each: list[Any] = [
            {"return": value, "success": i < flipped and i % 2 == parity}
            for i, value in enumerate(returns)
        ]
        return [Scored(row, "", []) for row in each]

    returns = 2 * np.resize([-1.0, -1.0, 1.0, 1.0], 200)
    pairs = list(zip(rows(returns + more, 0), rows(returns, 1), strict=True))
    found = "; ".join(beyond_chance(pairs))
    assert found.startswith(said) if said else not found


@pytest.mark.parametrize("reached", [199, 200])
def test_a_goal_of_200_may_end_differently_where_all_others_are_reached(
    reached: int,
) -> None:
    def rows(count: int) -> list[Scored]:
        succeeded: list[Any] = [
            {"return": 1.0, "success": i < count} for i in range(200)
        ]
        return [Scored(row, "", []) for row in succeeded]

    pairs = list(zip(rows(reached), rows(399 - reached), strict=True))
    assert list(beyond_chance(pairs)) == []
    pairs = list(zip(rows(200), rows(180), strict=True))
    assert any("20 of 200 goals have another" in text for text in beyond_chance(pairs))


# --- Refusals ----------------------------------------------------------------


def test_runs_of_several_settings_are_refused(runs: Path, tmp_path: Path) -> None:
    def refused(*names: str, **options: Any) -> str:
        with pytest.raises(UsageError) as error:
            marl_mm.submit([runs / n for n in names], out=tmp_path / "out", **options)
        assert "\n" not in str(error.value)
        return str(error.value)

    assert "updates = 400 (now 1)" in refused("long/0", "short/1")
    assert "both of seed 0" in refused("long/0", "long/0")
    assert "no run given" in refused()
    assert "is no run" in refused("long")
    assert "`episodes` is 0" in refused("long/0", episodes=0)
    assert "expected at most 2,000" in refused("long/0", episodes=2_001)
    unfinished = shutil.copytree(runs / "long/0", runs / "unfinished")
    (unfinished / EVALUATION).unlink()
    assert "not trained to its end" in refused("unfinished")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: v["dataset"].update(fingerprint="0" * 16), "dataset = "),
        (lambda v: v.pop("learning_rate"), "learning_rate = "),
        (lambda v: v.update(max_steps=3), "max_steps = "),
    ],
)
def test_seeds_of_other_data_or_settings_are_refused(
    change: Any, said: str, runs: Path, tmp_path: Path
) -> None:
    other = shutil.copytree(runs / "short/1", tmp_path / "other")
    edit(other / CONFIG, change)
    with pytest.raises(UsageError, match=said):
        marl_mm.submit([runs / "short/0", other], out=tmp_path / "out", episodes=1)


def test_nothing_is_overwritten_unasked_and_never_another_folder(
    runs: Path, copy: Path
) -> None:
    with pytest.raises(OutputExistsError):
        marl_mm.submit([runs / "long/0"], out=copy, episodes=2)
    with pytest.raises(UsageError, match=r"has no manifest\.json of marl-mm and"):
        marl_mm.submit([runs / "long/0"], out=runs, episodes=2, overwrite=True)
    with pytest.raises(UsageError, match="lies in another submission"):
        marl_mm.submit([runs / "long/0"], out=copy / "inner", episodes=2)
    (copy / ".git").mkdir()
    with pytest.raises(UsageError, match=r"holds \.git, which is not of marl-mm"):
        marl_mm.submit([runs / "long/0"], out=copy, episodes=2, overwrite=True)
    (copy / ".git").rmdir()
    notes = copy / "2024-notes/n.txt"
    notes.parent.mkdir()
    notes.touch()
    with pytest.raises(UsageError, match=r"holds 2024-notes/n\.txt, which is not"):
        marl_mm.submit([runs / "long/0"], out=copy, episodes=2, overwrite=True)
    shutil.rmtree(notes.parent)
    made = marl_mm.submit([runs / "long/0"], out=copy, episodes=2, overwrite=True)
    assert sorted(path.name for path in copy.iterdir()) == ["0", MANIFEST]
    assert "1 seed:" in repr(made)


def test_a_submission_that_is_stopped_leaves_nothing(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("marl_mm.runs.submit.described", stop)
    with pytest.raises(KeyboardInterrupt):
        marl_mm.submit([runs / "long/0"], out=tmp_path / "out", episodes=2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "nothing"],
        ["verify", "."],
        ["submit", "--out", "x"],
        ["submit", "nothing", "--out", "x"],
        ["board"],
        ["board", "nothing"],
    ],
)
def test_what_makes_no_sense_is_a_usage_error(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_it_is_made_of_is_never_replaced(
    runs: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shutil.copytree(runs / "long/0", copy / "inner/0")
    for out in (copy, run, run / "deeper"):
        with pytest.raises((UsageError, OutputExistsError), match="choose another"):
            marl_mm.submit(run, out=out, episodes=2, overwrite=True)
    assert (run / EVALUATION).exists()
    monkeypatch.setattr(submission_checks, "_MORE_STEPS", 0.1)
    with pytest.raises(UsageError, match=r"long/0 has episodes of 25 steps"):
        marl_mm.submit(runs / "long/0", out=copy.parent / "no", episodes=2)


def test_time_that_makes_no_sense_is_a_usage_error(honest: Path) -> None:
    with pytest.raises(UsageError, match="`minutes` is nan"):
        marl_mm.verify(honest, minutes=float("nan"))


def test_python_and_the_commands_do_the_same(
    runs: Path, honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["submit", str(runs / "long/0"), str(runs / "long/1"), "--workers", "2"]
    out = tmp_path / "out"
    assert main([*words, "--out", str(out), "--episodes", str(GOALS)]) == 0
    fingerprint = json.loads((honest / MANIFEST).read_text())["fingerprint"]
    assert fingerprint in capsys.readouterr().out
    assert main(["verify", str(out), "--json", "--seed", "5"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(verification_file(out).read_text())
    assert (printed["fingerprint"], printed["seed"]) == (fingerprint, 5)
    assert printed["verdict"] == "equal to the bit"
    assert main(["check", str(out)]) == 0
