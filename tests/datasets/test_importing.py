"""Export, import and 200 damaged files: what comes in is whole, or is named."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.hdf5 import ROBOT_NUMBERS
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode, failures
from marl_mm.sim.config import engine_of

MakeEpisode = Callable[..., Episode]
ID = "marl_mm/reach/test-v0"
FUZZED = 50


@pytest.fixture
def dataset(datasets_home: Path, make_episode: MakeEpisode) -> Path:
    """Episodes that could be real: modes, goals and actions in their ranges."""
    episodes = [make_episode(i, steps=3 + i % 3, success=i != 2) for i in range(6)]
    for episode in episodes:
        assert (episode.states[0, 7:] == episode.states[-1, 7:]).all()
        np.clip(episode.actions, REACH.low, REACH.high, out=episode.actions)
    provenance = Provenance(task="Reach-v0", collector="pd")
    write_dataset(locate(ID), arrays_of(episodes, ID), provenance)
    return datasets_home / ID


def run(*words: object) -> int:
    return main(list(map(str, words)))


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["flat", "agents", "minari"])
def test_what_goes_out_comes_in(
    dataset: Path, tmp_path: Path, layout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = dataset
    if layout != "minari":
        source = tmp_path / "flat.h5"
        words = ["datasets", "export", ID, "--out", source, "--layout", layout]
        assert run(*words, "--json") == 0
        assert json.loads(capsys.readouterr().out)["steps"] == 24
    assert run("datasets", "import", source, "--out", "marl_mm/reach/again-v0") == 0
    original, imported = load_dataset(ID), load_dataset("again")
    for name in ("states", "actions", "rewards", "terminated", "truncated", "lengths"):
        first, second = getattr(original.arrays, name), getattr(imported.arrays, name)
        np.testing.assert_array_equal(first, second)
    assert run("datasets", "verify", "again") == 0
    assert run("datasets", "verify", "again", "--replay") == 1
    assert "was imported" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["flat", "agents"])
def test_failures_and_the_engine_come_back(
    layout: str, datasets_home: Path, tmp_path: Path
) -> None:
    """Of a task whose episodes end in failures, too; without words the goal decides."""
    shipped = load_dataset("quiet-zone-noisy")
    few = shipped.arrays.select(range(60))
    assert 0 < few.successes().sum() < len(few) and few.failed().any()
    write_dataset(locate("few"), few, shipped.provenance)
    path = tmp_path / "few.h5"
    assert run("datasets", "export", "few", "--out", path, "--layout", layout) == 0
    assert run("datasets", "import", path, "--out", "told") == 0
    with h5py.File(path, "a") as file:
        del file["infos/is_success"]
    assert run("datasets", "import", path, "--out", "judged") == 0
    for name in ("told", "judged"):
        again = load_dataset(name)
        np.testing.assert_array_equal(again.arrays.failed(), few.failed())
        np.testing.assert_array_equal(again.arrays.successes(), few.successes())
        assert engine_of(again.provenance.overrides) == "mujoco"


def test_layouts_hold_what_they_say(dataset: Path, tmp_path: Path) -> None:
    joint = load_dataset(ID).joint()
    for layout in ("flat", "d4rl", "agents"):
        path = tmp_path / f"{layout}.h5"
        assert run("datasets", "export", ID, "--out", path, "--layout", layout) == 0
        assert run("datasets", "export", ID, "--out", path, "--layout", layout) == 2
        with h5py.File(path) as file:
            np.testing.assert_array_equal(file["terminals"], joint.terminated)
            assert list(file.attrs["agents"]) == ["end_effector", "balance"]
            if layout == "agents":
                both = [file[f"{name}/actions"][()] for name in file.attrs["agents"]]
                np.testing.assert_array_equal(np.hstack(both), joint.action)
                np.testing.assert_array_equal(file["state"], joint.observation)
            else:
                expected = np.float32 if layout == "d4rl" else np.float64
                assert file["observations"].dtype == expected
                np.testing.assert_allclose(
                    file["next_observations"], joint.next_observation, rtol=1e-6
                )


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("actions", None, "has no array 'actions'"),
        ("actions", np.zeros((24, 3), np.float32), r"'actions' has shape (24, 3)"),
        ("actions", np.full((24, 4), 2.0), "actions outside of the action space"),
        ("rewards", np.zeros(24, np.int64), "'rewards' has type int64, expected float"),
        ("rewards", np.full(24, np.nan), "'rewards' holds a NaN"),
        ("terminals", np.zeros(24, bool), "neither 'terminals' nor 'timeouts'"),
        ("terminals", np.full(24, np.nan), "'terminals' holds other values than 0"),
        ("observations", np.zeros((24, 11)), "has shape (24, 11), expected (24, 10)"),
        ("infos/is_success", np.full(24, 0.5), "other values than 0, 1 and NaN"),
        ("infos/is_success", np.full(24, b"yes"), "is_success' is no array of numbers"),
        ("infos/d_mm", np.zeros(25), "'infos/d_mm' has shape (25,), expected (24,)"),
    ],
)
def test_schema_errors_name_key_got_and_expected(
    dataset: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    key: str,
    value: np.ndarray | None,
    message: str,
) -> None:
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    with h5py.File(path, "a") as file:
        assert len(file["rewards"]) == 24
        if key == "terminals":
            file["timeouts"][:] = False
        if key in file:
            del file[key]
        if value is not None:
            file[key] = value
    capsys.readouterr()
    assert run("datasets", "import", path, "--out", "marl_mm/reach/bad-v0") == 1
    complaint = capsys.readouterr().err
    assert message in complaint and complaint.count("\n") == 1
    assert not locate("marl_mm/reach/bad-v0").folder.exists()


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [("engine", np.array([1, 2]), 1), ("seed", np.array([1, 2]), 0), ("layout", 5, 2)],
)
def test_attributes_of_any_type_are_read(
    dataset: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    value: Any,
    code: int,
) -> None:
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    with h5py.File(path, "a") as file:
        file.attrs[name] = value
    capsys.readouterr()
    assert run("datasets", "import", path, "--out", "other") == code
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_the_task_is_the_files(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    with h5py.File(path, "a") as file:
        file.attrs["task"] = "SmoothReach-v0"
    assert run("datasets", "import", path, "--out", "smooth") == 0
    assert load_dataset("smooth").metadata["marl_mm"]["task"] == "SmoothReach-v0"
    words = ["datasets", "import", path, "--out", "other", "--task", "Reach-v0"]
    assert run(*words) == 0
    assert load_dataset("other").metadata["marl_mm"]["task"] == "Reach-v0"
    folder = locate("smooth").folder
    assert run("datasets", "import", folder, "--out", "again") == 0
    assert load_dataset("again").metadata["marl_mm"]["task"] == "SmoothReach-v0"
    with h5py.File(path, "a") as file:
        for key, text in {"task": b"SmoothReach-v0", "engine": b"mujoco"}.items():
            file.attrs[key] = np.bytes_(text)  # as C programs write them
    assert run("datasets", "import", path, "--out", "bytes") == 0
    assert load_dataset("bytes").provenance.task == "SmoothReach-v0"
    assert load_dataset("bytes").provenance.engine == "mujoco"
    words = ["datasets", "import", path, "--out", "odd"]
    for key, value, code, expected in (
        ("engine", "MuJoCo 2.1", 2, "flat.h5 is of engine 'MuJoCo 2.1', expected bull"),
        ("task", 3, 1, "its task is"),
    ):
        with h5py.File(path, "a") as file:
            file.attrs[key] = value
        capsys.readouterr()
        assert run(*words) == code
        assert expected in capsys.readouterr().err
    assert run(*words, "--task", "Reach-v0", "--engine", "mujoco") == 0
    with h5py.File(path, "a") as file:
        file.attrs["engine"] = "bullet"
        file.attrs["task"] = "antmaze"
    capsys.readouterr()
    assert run("datasets", "import", path, "--out", "ants") == 2
    complaint = capsys.readouterr().err
    assert str(path) in complaint and "or give --task" in complaint


@pytest.mark.slow
def test_the_engine_and_longer_episodes_of_a_folder_come_along(
    datasets_home: Path, make_episode: MakeEpisode
) -> None:
    on_mujoco = {"simulation": {"engine": "mujoco"}, "max_steps": 40}
    arrays = arrays_of([make_episode(0, steps=30), make_episode(1)], ID)
    np.clip(arrays.actions, REACH.low, REACH.high, out=arrays.actions)
    provenance = Provenance(task="Reach-v0", collector="pd", overrides=on_mujoco)
    write_dataset(locate(ID), arrays, provenance)
    assert run("datasets", "import", datasets_home / ID, "--out", "again") == 0
    made = load_dataset("again").provenance
    assert (made.engine, made.overrides["max_steps"]) == ("mujoco", 30)


@pytest.mark.slow
def test_another_package_of_our_name_is_not_imported(
    dataset: Path, tmp_path: Path
) -> None:
    """As in the folder of another clone."""
    (tmp_path / "marl_mm").mkdir()
    (tmp_path / "marl_mm" / "__init__.py").write_text("raise RuntimeError")
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    program = Path(sys.executable).with_name("marl-mm")
    imported = subprocess.run(
        [program, "datasets", "import", path, "--out", "again"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert imported.returncode == 0, imported.stderr
    assert not imported.stderr


def test_what_is_no_file_is_named(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plain").mkdir()
    for words, message in (
        (["import", tmp_path / "plain", "--out", "x"], "is a folder without main_data"),
        (["import", tmp_path / "none.h5", "--out", "x"], "does not exist"),
        (["show", tmp_path / "plain"], "is a folder and no dataset of marl_mm"),
        (["mix", f"{ID}:5", "--out", tmp_path], "is left alone"),
    ):
        (tmp_path / "plain" / "notes.txt").write_text("mine")
        assert run("datasets", *words) == 2
        complaint = capsys.readouterr().err
        assert message in complaint and complaint.count("\n") == 1


def test_steps_that_do_not_join_are_refused(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    with h5py.File(path, "a") as file:
        file["next_observations"][0, 2] += 0.1
    assert run("datasets", "import", path, "--out", "bad") == 1
    assert "1 steps within an episode have" in capsys.readouterr().err
    assert run("datasets", "export", ID, "--out", tmp_path, "--overwrite") == 2
    assert "is a folder, expected a file" in capsys.readouterr().err


def test_observations_that_contradict_the_achieved_goal_are_refused(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as those of somebody who has the entries in another order."""
    path = tmp_path / "mine.hdf5"
    path.write_bytes((dataset / "data/main_data.hdf5").read_bytes())
    with h5py.File(path, "a") as file:
        seen = file["episode_1/observations/observation"]
        seen[:] = seen[:][:, [3, 1, 2, 0, *range(4, seen.shape[1])]]
    assert run("datasets", "import", path, "--task", "Reach-v0", "--out", "bad") == 1
    told = capsys.readouterr().err
    assert "episode 1: 'achieved_goal' is not what" in told and "end_effector_x" in told


def test_step_numbers_and_the_robots_come_along(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flat.h5"
    assert run("datasets", "export", ID, "--out", path) == 0
    values = np.arange(24.0)
    with h5py.File(path, "a") as file:
        file["infos/d_mm"] = values
        del file.attrs["engine"]
    words = ["datasets", "import", path, "--out", "mine", "--engine", "mujoco"]
    assert run(*words) == 0
    mine = load_dataset("mine")
    assert mine.provenance.engine_text == "mujoco"  # of a version that nobody knows
    np.testing.assert_array_equal(mine.arrays.info["d_mm"], values)
    assert np.isnan(mine.arrays.info["d_mp"]).all()
    assert mine.provenance.engine == "mujoco"
    assert mine.arrays.starts.shape == (6, ROBOT_NUMBERS)
    with h5py.File(path, "a") as file:
        file.attrs["engine"] = "bullet"
    assert run(*words, "--overwrite") == 2
    assert "flat.h5 is of engine bullet" in capsys.readouterr().err
    with h5py.File(path, "a") as file:
        file.attrs["engine"] = "mujoco"
        file["infos/d_mp"] = values[1:]
    assert run(*words, "--overwrite") == 1
    assert "'infos/d_mp' has shape (23,), expected (24,)" in capsys.readouterr().err


def test_what_is_missing_is_named_at_once(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "some.h5"
    with h5py.File(path, "w") as file:
        file["rewards"], file["actions"] = np.zeros(3), np.zeros((3, 4))
    assert run("datasets", "import", path, "--out", "some") == 1
    complaint = capsys.readouterr().err
    missing = "'terminals', 'timeouts', 'observations', 'next_observations'"
    assert f"has no array {missing}" in complaint
    for content in (b"", b"a,b\n1,2\n"):
        path.write_bytes(content)
        assert run("datasets", "import", path, "--out", "some") == 1
        assert "is no HDF5 file, or a damaged one" in capsys.readouterr().err


@pytest.mark.slow
def test_verify_finds_what_only_it_looks_at(
    dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A NaN in what was measured, and a cache that is of something else."""
    whole = load_dataset(ID)
    location, arrays = whole.location, whole.arrays
    assert run("datasets", "verify", ID) == 0
    provenance = Provenance(task="Reach-v0", collector="pd")
    arrays.info["zmp_margin"][5] = np.nan
    write_dataset(location, arrays, provenance, overwrite=True)
    capsys.readouterr()
    assert run("datasets", "verify", ID) == 1
    assert "1 values of infos/zmp_margin are NaN" in capsys.readouterr().out
    arrays.info["zmp_margin"][5] = 0.0
    write_dataset(location, arrays, provenance, overwrite=True)
    assert run("datasets", "verify", ID) == 0


def fuzz(path: Path, rng: np.random.Generator) -> str:
    """Damage an HDF5 file in one of seven ways; says how."""
    content = bytearray(path.read_bytes())
    kinds = ("truncated", "bits", "zeros", "type", "missing", "nan", "shape", "group")
    kind = str(rng.choice(kinds))
    if kind == "truncated":
        path.write_bytes(content[: rng.integers(len(content))])
    elif kind == "bits":
        for place in rng.integers(len(content), size=rng.integers(1, 20)):
            content[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
    elif kind == "zeros":
        begin = int(rng.integers(len(content)))
        content[begin : begin + 512] = bytes(len(content[begin : begin + 512]))
        path.write_bytes(content)
    else:
        with h5py.File(path, "a") as file:
            group = file[f"episode_{rng.integers(6)}"]
            key = str(rng.choice(["rewards", "actions", "observations/observation"]))
            values = group[key][()]
            del group[key]
            if kind == "type":
                group[key] = values.astype("S8")
            elif kind == "nan":
                values[rng.integers(len(values))] = np.nan
                group[key] = values
            elif kind == "shape":
                group[key] = values[:-1]
            elif kind == "group":
                group.create_group(key)
    return kind


@pytest.mark.slow
def test_damaged_files_give_clear_errors(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The dataset is refused, and its file alone is refused or whole."""
    path = dataset / "data" / "main_data.hdf5"
    good = path.read_bytes()
    whole = load_dataset(ID).arrays
    refused: dict[str, int] = {}
    number = damaged = 0
    while damaged < FUZZED:
        path.write_bytes(good)
        kind = fuzz(path, np.random.default_rng(number))
        number += 1
        if path.read_bytes() == good:  # zeros where zeros were
            continue
        damaged += 1
        capsys.readouterr()
        assert run("datasets", "show", ID) == 1, (number, kind)
        complaint = capsys.readouterr().err
        assert complaint.startswith("marl-mm: ") and complaint.count("\n") == 1
        assert "main_data.hdf5" in complaint
        assert run("datasets", "verify", ID) == 1
        capsys.readouterr()
        alone = tmp_path / "alone.hdf5"
        alone.write_bytes(path.read_bytes())
        out = tmp_path / "imported"
        words = ["datasets", "import", alone, "--out", out, "--overwrite"]
        code = run(*words)
        shown = capsys.readouterr()
        if code:
            assert code == 1 and shown.err.startswith("marl-mm: "), (number, kind)
            assert shown.err.count("\n") == 1
            refused[kind] = refused.get(kind, 0) + 1
        else:  # a number has another value: nothing but a hash can tell
            arrays = load_dataset(str(out)).arrays
            assert arrays.actions.shape[1:] == whole.actions.shape[1:]
    sure = {"truncated", "type", "missing", "nan", "shape", "group"}
    assert sure <= refused.keys()


def test_damaged_metadata_give_clear_errors(
    dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dataset / "data" / "metadata.json"
    good = path.read_text()
    outer = json.loads(good)
    places = [(True, key) for key in outer["marl_mm"]] + [(False, key) for key in outer]
    for number, (ours, key) in enumerate(places):
        damaged = json.loads(good)
        part = damaged["marl_mm"] if ours else damaged
        if number % 2:
            del part[key]
        else:
            part[key] = "something else"
        path.write_text(json.dumps(damaged))
        capsys.readouterr()
        assert run("datasets", "show", ID) == 1, key
        complaint = capsys.readouterr().err
        assert "metadata.json" in complaint and complaint.count("\n") == 1


def test_of_steps_whose_success_is_unknown_none_failed() -> None:
    """As of files of others that do not tell it."""
    ends = np.array([True, True, True, False])
    successes = np.array([1.0, 0.0, np.nan, 0.0])
    assert failures(ends, successes).tolist() == [False, True, False, False]
