"""Python and the command line do the same, to the byte, and Python prints nothing."""

import json
from collections.abc import Callable
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

import marl_mm
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.cli import main
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import CheckpointError, MarlMmError, OutputExistsError, UsageError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.progress import Advance
from marl_mm.runs import rebuilding
from marl_mm.runs.evaluate import save_evaluations
from marl_mm.runs.train import repeat

Capture = pytest.CaptureFixture[str]

FEW: dict[str, Any] = {
    "updates": 40,
    "hidden": (16, 16),
    "batch_size": 32,
    "eval_episodes": 2,
    "curve_episodes": 2,
    "max_steps": 2,
    "engine": "mujoco",  # the faster one
}
ONLINE = FEW | {"episodes": 4, "warm_up": 4, "epoch": 2, "updates_per_episode": 2}
del ONLINE["updates"]


def words(settings: dict[str, Any]) -> list[str]:
    """Settings as options."""
    options: list[str] = []
    for name, value in settings.items():
        values = value if isinstance(value, tuple) else (value,)
        options += [f"--{name.replace('_', '-')}", *map(str, values)]
    return options


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a folder; of TensorBoard's, which hold the time, none."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "tfevents" not in path.name
    }


def without_path(files: dict[str, bytes], *folders: Path) -> dict[str, bytes]:
    """The same with the folders' names left out of the files."""
    for folder in folders:
        name = str(folder).encode()
        files = {path: data.replace(name, b"") for path, data in files.items()}
    return files


@pytest.fixture
def quiet(capfd: pytest.CaptureFixture[str]) -> Callable[[], None]:
    """Asserts that nothing was printed since the last call."""

    def check() -> None:
        assert capfd.readouterr() == ("", "")

    return check


@pytest.mark.usefixtures("drawn")
@pytest.mark.slow
def test_collect_gives_the_bytes_of_the_command(
    tmp_path: Path, quiet: Callable[[], None], capfd: pytest.CaptureFixture[str]
) -> None:
    python, command = tmp_path / "python" / "d", tmp_path / "command" / "d"
    made = marl_mm.collect("pd", dataset=python, steps=12, seed=3, alpha_rule="room")
    quiet()
    assert made.arrays.steps >= 12
    options = ["--steps", "12", "--seed", "3", "--alpha-rule", "room"]
    assert main(["collect", "pd", "--dataset", str(command), *options]) == 0
    assert without_path(contents(python), python) == without_path(
        contents(command), command
    )


@pytest.mark.slow
def test_datasets_of_others_have_the_bytes_that_the_commands_give(
    datasets_home: Path, tmp_path: Path, quiet: Callable[[], None], capfd: Capture
) -> None:
    few: dict[str, Any] = {"steps": 30, "engine": "mujoco", "max_steps": 5}
    for name, seed in (("one", 0), ("two", 1)):
        marl_mm.collect("random", dataset=name, seed=seed, workers=1, **few)
    python = marl_mm.mix_datasets({"one": 20, "two": 10}, "python", seed=3)
    first, rest = marl_mm.split_dataset(python, share=0.6, seed=1)
    far = marl_mm.filter_dataset("python", "python-far", max_return=-0.1)
    file = tmp_path / "far.h5"
    assert main(["datasets", "export", "python-far", "--out", str(file)]) == 0
    capfd.readouterr()
    again = marl_mm.import_dataset(file, "python-again")
    quiet()
    for command in (
        "mix one:20 two:10 --out command --seed 3",
        "split command --share 0.6 --seed 1",
        "filter command --out command-far --max-return -0.1",
        f"import {file} --out command-again",
    ):
        assert main(["datasets", *command.split()]) == 0
    names = ("", "-first", "-rest", "-far", "-again")
    for name, ours in zip(names, (python, first, rest, far, again), strict=True):
        theirs = marl_mm.load_dataset(f"command{name}")
        here, there = (data.metadata["marl_mm"] for data in (ours, theirs))
        assert theirs.fingerprint == ours.fingerprint
        if name != "-again":  # whose episodes bear its name
            assert here["data_sha256"] == there["data_sha256"]
        assert theirs.card().keys() == ours.card().keys()
        assert (ours.location.folder / "card.json").exists()


@pytest.mark.slow
def test_export_gives_the_bytes_of_the_command(
    tmp_path: Path, quiet: Callable[[], None]
) -> None:
    python, command = tmp_path / "python.ts", tmp_path / "command.ts"
    about = marl_mm.export("pretrained", python)
    quiet()
    assert about["file"] == str(python) and about["largest_difference"] < 1e-4
    assert main(["export", "pretrained", "--out", str(command)]) == 0
    load: Any = torch.jit.load
    state = torch.zeros(1, len(about["observation"]))
    assert (load(python)(state) == load(command)(state)).all()


@pytest.mark.usefixtures("drawn")
@pytest.mark.slow
def test_train_offline_gives_the_bytes_of_the_command(
    tmp_path: Path, quiet: Callable[[], None], datasets_home: Path
) -> None:
    python, command = tmp_path / "python", tmp_path / "command"
    data = marl_mm.load_dataset("good-5k")
    runs = marl_mm.train("td3-bc", data, out=python, seeds=(0, 1), **FEW)
    quiet()
    assert [run.config.seed for run in runs] == [0, 1]
    arguments = ["--dataset", "good-5k", "--out", str(command), "--seeds", "0", "1"]
    assert main(["train", "td3-bc", *arguments, *words(FEW)]) == 0
    assert without_path(contents(python), python) == without_path(
        contents(command), command
    )


@pytest.mark.usefixtures("drawn")
@pytest.mark.slow
def test_train_online_gives_the_bytes_of_the_command(
    tmp_path: Path, quiet: Callable[[], None]
) -> None:
    python, command = tmp_path / "python", tmp_path / "command"
    (run,) = marl_mm.train("maddpg-her", task="SmoothReach-v0", out=python, **ONLINE)
    quiet()
    assert run.best_evaluation is not None
    arguments = ["--task", "SmoothReach-v0", "--out", str(command), *words(ONLINE)]
    assert main(["train", "maddpg-her", *arguments]) == 0
    assert without_path(contents(python), python) == without_path(
        contents(command), command
    )


@pytest.mark.usefixtures("drawn")
def test_a_run_that_never_learnt_says_so(tmp_path: Path) -> None:
    settings = ONLINE | {"warm_up": 9}  # there are eight steps
    (run,) = marl_mm.train("ddpg-her", out=tmp_path, **settings)
    assert run.summary().endswith("; no update in 8 steps: see `warm_up`")


@pytest.mark.slow
def test_evaluate_gives_the_bytes_of_the_command(
    tmp_path: Path, quiet: Callable[[], None]
) -> None:
    python, command = tmp_path / "python.json", tmp_path / "command.json"
    few: dict[str, Any] = {"episodes": 4, "seed": 2, "max_steps": 3}
    evaluations = [
        marl_mm.evaluate("pretrained", **few),
        marl_mm.evaluate("pd", alpha_rule="room", **few),
    ]
    save_evaluations(evaluations, python)
    quiet()
    arguments = ["pretrained", "pd", "--pd.alpha-rule", "room", "--out", str(command)]
    assert main(["eval", *arguments, *words(few)]) == 0
    assert python.read_bytes() == command.read_bytes()


@pytest.mark.slow
def test_what_was_stopped_goes_on_with_what_it_began_with(
    tmp_path: Path, datasets_home: Path
) -> None:
    part, whole = tmp_path / "part", tmp_path / "whole"
    marl_mm.train("mabc", "good-5k", out=part, seeds=(5,), **{**FEW, "updates": 20})
    (run,) = marl_mm.train("mabc", out=part, resume=True, updates=40)
    assert run.config.settings["hidden"] == [16, 16]
    same: dict[str, Any] = {"resume": True, "preset": "tuned"}
    (run,) = marl_mm.train("mabc", out=part, **same)
    assert run.config.settings["hidden"] == [16, 16]
    assert run.config.settings["updates"] == 40
    marl_mm.train("mabc", "good-5k", out=whole, seeds=(5,), **FEW)
    weights = [(out / "5" / "checkpoint.pt").read_bytes() for out in (part, whole)]
    assert weights[0] == weights[1]

    began: dict[str, Any] = {"seed": 4, "alpha": 0.5, "engine": "mujoco"}
    short = marl_mm.collect("pd", dataset=tmp_path / "d", steps=8, **began)
    longer = marl_mm.collect("pd", dataset=tmp_path / "d", steps=30, resume=True)
    assert longer.provenance.seed == 4
    first = short.arrays.steps
    assert np.array_equal(longer.joint().action[:first], short.joint().action)


@pytest.mark.slow
def test_an_interrupted_collection_is_a_valid_dataset(tmp_path: Path) -> None:
    def bar(label: str, total: int) -> Advance:
        def advance(done: int, note: str) -> None:
            if done:
                raise KeyboardInterrupt

        return advance

    more: dict[str, Any] = {"steps": 30, "engine": "mujoco"}
    with pytest.raises(KeyboardInterrupt, match="resume=True"):
        marl_mm.collect("pd", dataset=tmp_path / "d", progress=bar, **more)
    assert main(["datasets", "verify", str(tmp_path / "d")]) == 0
    whole = marl_mm.collect("pd", dataset=tmp_path / "d", resume=True, **more)
    uninterrupted = marl_mm.collect("pd", dataset=tmp_path / "e", **more)
    assert whole.fingerprint == uninterrupted.fingerprint


@pytest.mark.slow
def test_loggers_are_chosen_by_name_and_change_no_byte(
    tmp_path: Path, datasets_home: Path
) -> None:
    few = FEW | {"updates": 4}
    (plain,) = marl_mm.train("mabc", "good-5k", out=tmp_path / "a", **few)
    (other,) = marl_mm.train(
        "mabc", "good-5k", out=tmp_path / "b", logger=("csv",), **few
    )
    assert list(plain.folder.glob("events.out.tfevents.*"))
    assert not list(other.folder.glob("events.out.tfevents.*"))
    assert (other.folder / "metrics.csv").read_text().startswith("step,")
    assert other.config.settings == {**plain.config.settings, "logger": ["csv"]}
    for name in ("checkpoint.pt", "metrics.jsonl"):
        same = [(run.folder / name).read_bytes() for run in (plain, other)]
        assert same[0] == same[1], name
    more = FEW | {"updates": 300}
    (other,) = marl_mm.train("mabc", out=tmp_path / "b", resume=True, **more)
    assert (other.folder / "metrics.csv").read_text().count("\n300,") == 1
    assert not list(other.folder.glob("events.out.tfevents.*"))
    with pytest.raises(UsageError, match="no logger 'fly', expected one of tensor"):
        marl_mm.train("mabc", "good-5k", out=tmp_path / "c", logger=("fly",), **few)


@pytest.mark.slow
def test_switches_that_are_off_stay_off_where_a_run_goes_on(
    tmp_path: Path, datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(arrays: EpisodeArrays) -> np.ndarray:
        return np.zeros(len(arrays), bool)

    monkeypatch.setattr(EpisodeArrays, "successes", none)
    monkeypatch.chdir(tmp_path)
    off: dict[str, Any] = {"require_success": False, "stop_diverging": False}
    (run,) = marl_mm.train("td3-bc", "good-5k", out="a", **off, **FEW)
    assert off.items() <= run.config.settings.items()
    (more,) = marl_mm.train("td3-bc", out="a", resume=True, **FEW | {"updates": 60})
    again = repeat(run.config, out="b")
    (further,) = marl_mm.train("td3-bc", start="a/0", out="c", online_steps=2)
    for each in (more, again, further):
        assert off.items() <= each.config.settings.items()
    assert further.config.settings["start"] == str(tmp_path / "a/0")
    on: dict[str, Any] = {"stop_diverging": True, "resume": True}
    (more,) = marl_mm.train("td3-bc", out="a", **on)
    assert more.config.settings["stop_diverging"]
    (more.folder / "checkpoint.pt").unlink()
    kept = contents(more.folder)
    with pytest.raises(UsageError, match=r"has an eval.json but no checkpoint.pt"):
        marl_mm.train("td3-bc", out="a", resume=True)
    assert contents(more.folder) == kept


@pytest.mark.slow
def test_a_run_is_repeated_from_its_record(
    tmp_path: Path, datasets_home: Path, capfd: Capture
) -> None:
    (run,) = marl_mm.train("matd3-bc", "good-5k", out=tmp_path / "a", seeds=(3,), **FEW)
    again = repeat(run.config, out=tmp_path / "b")
    record = str(run.folder / "config.json")
    assert main(["train", "--config", record, "--out", str(tmp_path / "c")]) == 0
    first, *others = (
        without_path(contents(folder), folder)
        for folder in (run.folder, again.folder, tmp_path / "c" / "3")
    )
    assert others == [first, first]
    moved = repeat(run, out=tmp_path / "m", dataset="good-5k")
    assert moved.config == run.config
    assert run.config.dataset is not None
    sent = replace(run.config, dataset={k: run.config.dataset[k] for k in ("id",)})
    with pytest.raises(UsageError, match="does not say where marl_mm/reach/good-5k"):
        repeat(sent, out=tmp_path / "s")
    taken: list[dict[str, Any]] = [{"preset": "paper"}, {"algorithm": "mabc"}]
    for name, settings in ((min(settings), settings) for settings in taken):
        with pytest.raises(UsageError, match=f"`{name}` of a repeated run is its own"):
            repeat(run, out=tmp_path / "n", **settings)
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(CheckpointError, match=r"other\.json is no run's: it lacks alg"):
        repeat(tmp_path / "other.json", out=tmp_path / "n")
    with pytest.raises(UsageError, match="`out` is '', expected a folder"):
        repeat(run.folder, out="")
    eight: dict[str, Any] = {"dataset": tmp_path / "d", "steps": 8, "engine": "mujoco"}
    marl_mm.collect("pd", **eight)
    (own,) = marl_mm.train("mabc", tmp_path / "d", out=tmp_path / "e", **FEW)
    marl_mm.collect("pd", seed=1, overwrite=True, **eight)
    with pytest.raises(UsageError, match="the run learnt from"):
        repeat(own.config, out=tmp_path / "f")
    capfd.readouterr()
    record = str(own.folder)
    assert main(["train", "--config", record, "--out", str(tmp_path / "f")]) == 2
    assert "name its --dataset" in capfd.readouterr().err


@pytest.mark.slow
def test_runs_are_listed_with_their_scores_whatever_is_damaged(
    tmp_path: Path, datasets_home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = FEW | {"updates": 4}
    run, other = marl_mm.train("mabc", "good-5k", out=tmp_path, seeds=(0, 1), **few)
    (other.folder / "eval.json").write_text("{")
    assert main(["runs", str(tmp_path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["run"] for row in rows] == ["0", "1"]
    assert run.evaluation is not None
    assert rows[0]["success [%]"] == 100 * run.evaluation.success_rate
    assert rows[0]["trained"] == "4 of 4 updates"
    assert "eval.json" in rows[1]["note"]
    assert main(["runs", str(tmp_path)]) == 0
    assert "4 of 4 updates" in capsys.readouterr().out
    assert main(["runs", str(tmp_path / "none")]) == 2


@pytest.mark.slow
def test_a_run_and_its_film_are_read_back(
    tmp_path: Path, datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (made,) = marl_mm.train("mabc", "good-5k", out=tmp_path, **FEW)
    run = marl_mm.load_run(tmp_path / "0")
    assert run.metrics[-1]["step"] == 40
    evaluation = run.evaluation
    assert evaluation is not None
    again = marl_mm.evaluate(made, episodes=2, max_steps=2)
    assert again.rows == evaluation.rows
    assert " reached 0 of 2 goals of Reach-v0>" in repr(again)
    page = run._repr_html_()
    assert page.count("data:image/png;base64,") == 2
    with monkeypatch.context() as without:
        without.setattr("marl_mm.sim.config.find_spec", lambda name: None)
        assert run._repr_html_().count("data:image/png;base64,") == 1
    before = run.policy.fingerprint
    more = FEW | {"updates": 60, "resume": True}
    marl_mm.train("mabc", "good-5k", out=tmp_path, **more)
    assert run.policy.fingerprint != before
    film = marl_mm.play(run, max_steps=2, fps=2)
    film.save(tmp_path / "film.gif")
    film.strip(tmp_path / "film.png")
    assert (tmp_path / "film.gif").read_bytes().startswith(b"GIF8")
    assert "video/mp4" in film._repr_html_()
    assert len(film.frames) == 5
    empty = replace(film, frames=[])  # as of a window
    assert empty._repr_html_() == escape(repr(empty))
    with pytest.raises(UsageError, match="has no pictures"):
        empty.save(tmp_path / "empty.gif")
    assert "reach" in repr(film)
    with pytest.raises(OutputExistsError):
        film.save(tmp_path / "film.gif")
    with pytest.raises(UsageError, match=r"name one of its runs, such as .*/0"):
        marl_mm.load_run(tmp_path)


ROW: Any = {"seed": 1, "success": True}
ONE = Evaluation("pd", {}, "Reach-v0", {}, 0, [ROW])
"""An evaluation of one goal."""


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: marl_mm.train("mabc"), "mabc learns from a dataset: name one"),
        (lambda: marl_mm.train("ddpg", "good-5k"), "takes no `dataset`: use bc, mabc"),
        (lambda: marl_mm.train("mabc", "good-5k", update=5), "did you mean updates?"),
        (
            lambda: marl_mm.train("mabc", "good-5k", updates="5"),
            "mabc: updates is '5', expected a whole number",
        ),
        (lambda: marl_mm.train("mabc", "good-5k", seeds=()), "names no seed"),
        (lambda: marl_mm.collect("pd", alpha_rul="room"), "did you mean alpha_rule?"),
        (lambda: marl_mm.collect("fly"), "unknown collector 'fly'"),
        (lambda: marl_mm.evaluate("fly"), "no policy 'fly': expected pretrained, pd"),
        (lambda: marl_mm.evaluate("pretrained", alpha=1.0), "takes no settings"),
        (lambda: marl_mm.evaluate("pd", episodes=0), "`episodes` is 0, expected >= 1"),
        (lambda: marl_mm.play("pd", fps=0), "`fps` is 0, expected >= 1"),
        (lambda: marl_mm.play("pd", direction=cast(Any, "up")), "`direction` is 'up'"),
        (
            lambda: marl_mm.evaluate("pd", episodes=cast(Any, "1")),
            "`episodes` is '1', expected a whole number",
        ),
        (
            lambda: marl_mm.evaluate("pd", seed=cast(Any, 0.5)),
            "the seed is 0.5, expected a whole number",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", seeds=cast(Any, 3)),
            "`seeds` is 3, expected several",
        ),
        (lambda: marl_mm.train(cast(Any, None)), "algorithm is None, expected a name"),
        (
            lambda: marl_mm.train("mabc", "good-5k", out=cast(Any, 3)),
            "`out` is 3, expected a fol",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", batch_size=True),
            "batch_size is True, expected a number",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", logger=("csv", "csv")),
            "`logger` is csv csv, expected each once",
        ),
        (
            lambda: marl_mm.train(
                "ddpg-her", demonstrations="good-5k", demonstration_share=0.001
            ),
            "no transition of a batch is a demonstration; raise it",
        ),
        (lambda: marl_mm.load_run("nowhere"), "nowhere is no run"),
        (
            lambda: marl_mm.train(
                "td3-bc", "good-5k", config=Td3BcConfig(imitate=cast(Any, "hits"))
            ),
            "config: imitate is 'hits'",
        ),
        (
            lambda: marl_mm.train(
                "mabc", "good-5k", config=MabcConfig(batch_size=cast(Any, 1.5))
            ),
            "config: batch_size is 1.5",
        ),
        (lambda: marl_mm.load_run(cast(Any, None)), "None is no folder"),
        (lambda: marl_mm.find_runs(cast(Any, 5)), "`folder` is 5, expected one with"),
        (lambda: marl_mm.export("pretrained", cast(Any, 5)), "`out` is 5, expected a"),
        (
            lambda: marl_mm.repeat(cast(Any, 5), out="x"),
            "`config` is 5, expected a run",
        ),
        (lambda: marl_mm.cross_play(cast(Any, 5)), "5 are no policies, expected 2"),
        (lambda: marl_mm.Study("x", cast(Any, 5)), "5 are no cells, expected a"),
        (lambda: marl_mm.load_policy(3), "3 is no policy, expected a run"),
        (lambda: marl_mm.evaluate(None), "None is no policy"),
        (lambda: marl_mm.load_dataset(cast(Any, None)), "None is no dataset's name"),
        (
            lambda: marl_mm.collect("pd", steps="a"),
            "collect: steps is 'a', expected a whole number or None",
        ),
        (
            lambda: marl_mm.collect("pd", alpha_rule="left"),
            "alpha_rule is 'left', expected constant or direction or room",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", hidden="wide"),
            "hidden is 'wide', expected (a whole number, ...)",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", config=3),
            "`config` is 3, expected a MabcConfig",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", preset="x", config=MabcConfig()),
            "`config` has all hyper-parameters: leave out `preset`",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", hidden=(True,)),
            "hidden is (True,), expected a number",
        ),
        (lambda: marl_mm.evaluate("pd", config={}), "`config` is {}, expected a Pd"),
        (lambda: marl_mm.collect("pd", config={}), "`config` is {}, expected a Pd"),
        (lambda: marl_mm.evaluate("pretrained", config={}), "no settings, got config"),
        (lambda: marl_mm.collect("pd", dataset=cast(Any, 3)), "expected an id or a"),
        (lambda: marl_mm.train("mabc", "good-5k", start=3), "`start` is 3, expected a"),
        (
            lambda: marl_mm.cross_play(["pd", "random"], configs=[None]),
            "`configs` are 1, expected 2",
        ),
        (lambda: marl_mm.mix_datasets({}, "x"), "`parts` is {}, expected datasets"),
        (lambda: marl_mm.mix_datasets(cast(Any, 3), "x"), "`parts` is 3, expected"),
        (
            lambda: marl_mm.mix_datasets({"good-5k": cast(Any, "9")}, "x"),
            "'9' steps of good-5k are asked for, expected a whole",
        ),
        (
            lambda: marl_mm.mix_datasets({"good-5k": 10**6}, "x"),
            "steps, asked for 1000000: expected 1 to",
        ),
        (
            lambda: marl_mm.mix_datasets({"good-5k": 9}, cast(Any, None)),
            "`out` is None, expected an id or a path",
        ),
        (
            lambda: marl_mm.filter_dataset("good-5k", "x", outcome=cast(Any, "won")),
            "`outcome` is 'won', expected reached or missed",
        ),
        (
            lambda: marl_mm.filter_dataset("good-5k", "x", direction=cast(Any, "up")),
            "filter: direction is 'up'",
        ),
        (lambda: marl_mm.filter_dataset("good-5k", "x"), "no condition: expected an"),
        (lambda: marl_mm.split_dataset("good-5k", share=2), "the share is 2, expected"),
        (
            lambda: marl_mm.split_dataset("good-5k", share=cast(Any, "a")),
            "the share is 'a', expected",
        ),
        (
            lambda: marl_mm.split_dataset("good-5k", out=cast(Any, 3)),
            "`out` is 3, expected the beginning of a name",
        ),
        (
            lambda: marl_mm.filter_dataset("good-5k", "x", outcome="missed"),
            "has `outcome` missed: nothing to write",
        ),
        (
            lambda: marl_mm.train("mabc", "good-5k", updates=10**8),
            "make 1,050,000 rows of metrics.jsonl, expected at most 100,000",
        ),
        (lambda: marl_mm.repeat("nowhere", out="x"), "there is no 'nowhere', expected"),
        (lambda: marl_mm.play(camera=cast(Any, "x")), "`camera` is 'x', expected a"),
        (
            lambda: marl_mm.train("ddpg", demonstration_share=0.9),
            "0.9, but there are no `demonstrations`, so that it has no effect",
        ),
        (lambda: marl_mm.import_dataset(cast(Any, 3), "x"), "`file` is 3, expected a"),
        (
            lambda: marl_mm.import_dataset("x", "y", engine=cast(Any, "Bullet")),
            "`engine` is 'Bullet', expected bullet or mujoco",
        ),
        (
            lambda: marl_mm.import_dataset("lo\u200bg.h5", "y"),
            "the file's name has a control character",
        ),
        (
            lambda: marl_mm.collect("medium", agent="runs/r\udce9"),
            "agent has a control character in it",
        ),
        (lambda: rebuilding.rebuild(cast(Any, 5)), "`card` is 5, expected a card or a"),
        *(
            (
                lambda m=m: marl_mm.verify("x", minutes=m),
                f"`minutes` is {m!r}, expected",
            )
            for m in (True, None, [1], "2", 0)
        ),
        (lambda: marl_mm.export("nowhere"), "nowhere"),
        (lambda: marl_mm.board(cast(Any, 3)), "3 is no submission, expected folders"),
        (lambda: marl_mm.board([cast(Any, 3)]), "3 is no folder, expected a subm"),
        (lambda: marl_mm.submit(cast(Any, None), out="x"), "None is no run, expected"),
        (
            lambda: marl_mm.train("mabc", "good-5k", out="a\0b", updates=1),
            "the path has a control character",
        ),
        (lambda: ONE.less(replace(ONE, task="Grasp-v0")), "not on the same goals"),
        (lambda: ONE.less(replace(ONE, rows=[])), "not on the same goals"),
    ],
)
def test_mistakes_are_told_in_one_line(
    call: Callable[[], Any], message: str, datasets_home: Path
) -> None:
    with pytest.raises(MarlMmError) as raised:
        call()
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_algorithms_own_check_of_its_settings_is_asked(
    tmp_path: Path, datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(config: MabcConfig) -> None:
        raise UsageError(f"{config.updates} updates are too many")

    own = replace(ALGORITHMS.get("mabc"), check=refuse)
    monkeypatch.setitem(ALGORITHMS._things, "mabc", own)
    with pytest.raises(UsageError, match="9 updates are too many"):
        marl_mm.train("mabc", "good-5k", out=tmp_path / "run", updates=9)


@pytest.mark.slow
def test_runs_come_in_the_order_of_the_seeds(
    tmp_path: Path, datasets_home: Path
) -> None:
    few = FEW | {"updates": 4, "workers": 2}
    seeds: Any = np.array([2, 0, 1])
    runs = marl_mm.train("mabc", "good-5k", out=tmp_path, seeds=seeds, **few)
    assert [run.config.seed for run in runs] == [2, 0, 1]
    with pytest.raises(UsageError, match="there is nothing to learn"):
        marl_mm.train("mabc", out=tmp_path / "on", start=runs[0], **few)


@pytest.mark.slow
def test_an_error_of_a_callback_ends_the_training_and_is_raised(
    tmp_path: Path, datasets_home: Path
) -> None:
    def bar(label: str, total: int) -> Advance:
        def advance(done: int, note: str) -> None:
            raise RuntimeError("full")

        return advance

    few = FEW | {"updates": 100_000, "workers": 2}
    with pytest.raises(RuntimeError, match="full"):
        marl_mm.train(
            "mabc", "good-5k", out=tmp_path, seeds=(0, 1), progress=bar, **few
        )


def test_the_package_offers_what_it_names() -> None:
    assert {*marl_mm.__all__} <= {*dir(marl_mm)}  # what an editor completes
    for name in marl_mm.__all__:
        assert callable(getattr(marl_mm, name)), name
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        _ = marl_mm.fly


def test_results_are_shown_as_json_that_the_command_prints(capfd: Capture) -> None:
    evaluation = marl_mm.evaluate("pd", episodes=2, max_steps=2)
    assert main(["eval", "pd", "--episodes", "2", "--max-steps", "2", "--json"]) == 0
    (printed,) = json.loads(capfd.readouterr().out)
    del printed["packages"]
    assert printed == json.loads(json.dumps(evaluation.to_json()))


def test_the_curve_has_other_goals_than_the_evaluation(
    tmp_path: Path, datasets_home: Path
) -> None:
    """Those of the next seed: what is chosen by the curve has not seen the others."""
    goals: dict[str, Any] = {"max_steps": 2, "engine": "mujoco"}
    few: dict[str, Any] = {"updates": 1, "hidden": (8,), "batch_size": 8, "logger": ()}
    few |= {"curve_episodes": 2, "eval_episodes": 2, "eval_seed": 7, **goals}
    (run,) = marl_mm.train("mabc", "good-5k", out=tmp_path, **few)
    of_curve = marl_mm.evaluate(run, episodes=2, seed=8, **goals)
    assert run.metrics[-1]["return/all"] == of_curve.summary["all"]["return"]
    assert run.evaluated.rows == marl_mm.evaluate(run, episodes=2, seed=7, **goals).rows
    assert run.evaluated.rows != of_curve.rows
