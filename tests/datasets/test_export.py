"""Every form of export holds each value of the dataset, whole or not at all."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import gymnasium
import h5py
import numpy as np
import pytest

from marl_mm import collect, versions
from marl_mm.cli import main
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.card import keep_card
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.export import DATASET_FORMS, DatasetForm, export
from marl_mm.datasets.hdf5 import FILE
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError, OutputExistsError, UsageError

ID = "marl_mm/reach/test-v0"
LENGTHS = (3, 4, 5, 3)
OUT_OF_STEPS = 2
"""The episode that reaches nothing."""

FORMS = DATASET_FORMS.names()


@pytest.fixture
def dataset(datasets_home: Path, make_episode: Callable[..., Episode]) -> Dataset:
    episodes = [
        make_episode(i, steps=steps, success=i != OUT_OF_STEPS)
        for i, steps in enumerate(LENGTHS)
    ]
    for episode in episodes:
        np.clip(episode.actions, REACH.low, REACH.high, out=episode.actions)
    provenance = Provenance(task="Reach-v0", collector="pd")
    write_dataset(locate(ID), arrays_of(episodes, ID), provenance)
    return load_dataset(ID)


def written(dataset: Dataset, form: str, folder: Path, name: str = "out") -> Path:
    for package in DATASET_FORMS.get(form).packages:
        pytest.importorskip(package)
    export(dataset, form, folder / name, overwrite=False)
    return folder / name


def contents(path: Path) -> dict[str, bytes]:
    """Bytes of a file, or of those in a folder, by path."""
    files = [file for file in (path, *path.rglob("*")) if file.is_file()]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def equal(values: Any, expected: np.ndarray) -> None:
    """Equal to the bit, once the expected values have the type of the others."""
    values = np.asarray(values)
    np.testing.assert_array_equal(values, expected.astype(values.dtype))


def test_a_dataset_may_be_named(tmp_path: Path, datasets_home: Path) -> None:
    export("good-5k", "flat", tmp_path / "named.hdf5")
    export(load_dataset("good-5k"), "flat", tmp_path / "read.hdf5")
    assert contents(tmp_path / "named.hdf5") == contents(tmp_path / "read.hdf5")
    with pytest.raises(UsageError, match="`path` is 5, expected a file or folder"):
        export("good-5k", "flat", cast(Any, 5))
    with pytest.raises(UsageError, match="only shells know ~"):
        export("good-5k", "flat", "~/named.hdf5")


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_what_exists_is_kept_and_nothing_else_is_written(
    dataset: Dataset, tmp_path: Path, form: str
) -> None:
    folder = tmp_path / "exported"
    path = written(dataset, form, folder)
    before = contents(path)
    with pytest.raises(OutputExistsError):
        export(dataset, form, path, overwrite=False)
    assert contents(path) == before
    export(dataset, form, path, overwrite=True)
    assert [*folder.iterdir()] == [path]
    if form != "flashbax":  # its database names files at random
        assert contents(path) == before
    if path.is_dir():
        (path / ".git").mkdir()
        with pytest.raises(UsageError, match=r"holds \.git, which is not of marl-mm"):
            export(dataset, form, path, overwrite=True)
        assert (path / ".git").exists()


@pytest.mark.parametrize("form", FORMS)
def test_what_is_of_another_kind_is_not_replaced(
    dataset: Dataset, tmp_path: Path, form: str
) -> None:
    folder, file = tmp_path / "folder", tmp_path / "file"
    folder.mkdir()
    for mine in (file, folder / "mine"):
        mine.write_text("mine")
    mark = DATASET_FORMS.get(form).mark
    of_folders = mark is not None
    if mark is not None:  # the same name of somebody else's
        (folder / mark[0]).parent.mkdir(exist_ok=True)
        (folder / mark[0]).write_text('{"version": 1}')
    for path, refused in ((file, of_folders), (folder, True)):
        if refused:
            with pytest.raises(UsageError, match=r"expected a|is not replaced"):
                export(dataset, form, path, overwrite=True)
    assert {*contents(tmp_path)} >= {"file", "folder/mine"}
    data = dataset.location.data
    with pytest.raises(UsageError, match="lies within the dataset"):
        export(dataset, form, data if of_folders else data / FILE, overwrite=True)


@pytest.mark.parametrize("mark", [None, ("mark", "")])
def test_a_write_that_fails_leaves_nothing(
    dataset: Dataset,
    tmp_path: Path,
    mark: tuple[str, str] | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(dataset: Dataset, path: Path) -> None:
        (path / "half" if mark else path).write_text("half")
        raise OSError("the disk is full")

    forms = {"broken": DatasetForm(about="", write=broken, mark=mark)}
    monkeypatch.setattr(DATASET_FORMS, "_things", forms)
    (tmp_path / "out").mkdir()
    with pytest.raises(OSError, match="full"):
        export(dataset, "broken", tmp_path / "out/x", overwrite=False)
    assert not [*(tmp_path / "out").iterdir()]


def test_a_form_that_is_unknown_or_lacks_a_package_is_named(
    dataset: Dataset,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["datasets", "export", ID, "--out", str(tmp_path / "x"), "--layout"]
    assert main([*words, "lerobt"]) == 2
    complaint = capsys.readouterr().err
    assert "did you mean lerobot?" in complaint and "robomimic" in complaint
    with monkeypatch.context() as patch:
        patch.setattr(versions, "find_spec", lambda name: None)
        assert main([*words, "lerobot"]) == 2
    assert "pyarrow missing: pip install -e '.[lerobot]'" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
    assert main([*words, "hub", "--json"]) == 0
    size = sum(map(len, contents(tmp_path / "x").values()))
    assert json.loads(capsys.readouterr().out)["bytes"] == size


def test_robomimic_has_states_and_the_agents_parts(
    dataset: Dataset, tmp_path: Path
) -> None:
    joint, agents = dataset.joint(), dataset.agents()
    with h5py.File(written(dataset, "robomimic", tmp_path)) as file:
        data = file["data"]
        assert data.attrs["total"] == sum(LENGTHS)
        about = json.loads(data.attrs["env_args"])
        env = gymnasium.make(about["env_name"], **about["env_kwargs"])
        assert isinstance(env.unwrapped, GoalEnv)
        env.close()
        demos = [data[f"demo_{number}"] for number in range(len(LENGTHS))]
        assert tuple(demo.attrs["num_samples"] for demo in demos) == LENGTHS

        def all_of(key: str) -> np.ndarray:
            return np.concatenate([demo[key][()] for demo in demos])

        equal(all_of("actions"), joint.action)
        equal(all_of("rewards"), joint.reward)
        equal(all_of("dones"), joint.terminated)  # not where steps ran out
        assert not demos[OUT_OF_STEPS]["dones"][()].any()
        for name, view in {"state": joint, **agents}.items():
            equal(all_of(f"obs/{name}"), view.observation)
            equal(all_of(f"next_obs/{name}"), view.next_observation)


def test_ogbench_has_a_row_for_the_last_states(
    dataset: Dataset, tmp_path: Path
) -> None:
    file = np.load(written(dataset, "ogbench", tmp_path))
    joint, arrays = dataset.joint(), dataset.arrays
    assert {file[key].dtype.str for key in file if key != "marl_mm"} == {"<f4"}
    equal(file["observations"], arrays.states)
    equal(file["terminals"], arrays.is_last_state())
    steps = file["terminals"] == 0
    equal(file["actions"][steps], joint.action)
    equal(file["rewards"][steps], joint.reward)
    equal(file["masks"][steps], ~joint.terminated)
    assert not file["actions"][~steps].any()


def test_d3rlpy_has_episodes_that_ended_or_ran_out(
    dataset: Dataset, tmp_path: Path
) -> None:
    joint = dataset.joint()
    with h5py.File(written(dataset, "d3rlpy", tmp_path)) as file:
        numbers = range(int(file["num_episodes"][()]))
        assert [name.decode() for name in file["columns"][()]] == [
            *("observations", "actions", "rewards", "terminated")
        ]

        def all_of(key: str) -> np.ndarray:
            return np.concatenate([file[f"{key}_{number}"][()] for number in numbers])

        equal(all_of("observations"), joint.observation)
        equal(all_of("actions"), joint.action)
        equal(all_of("rewards")[:, 0], joint.reward)
        ended = [bool(file[f"terminated_{number}"][()]) for number in numbers]
        assert ended == [number != OUT_OF_STEPS for number in numbers]


def test_lerobot_has_frames_episodes_names_and_statistics(
    dataset: Dataset, tmp_path: Path
) -> None:
    path = written(dataset, "lerobot", tmp_path)
    from pyarrow import parquet

    def column(table: Any, key: str) -> np.ndarray:
        return np.array(table[key].to_pylist())

    joint = dataset.joint()
    frames = parquet.read_table(path / "data/chunk-000/file-000.parquet")
    equal(column(frames, "observation.state").astype("f4"), joint.observation)
    equal(column(frames, "action").astype("f4"), joint.action)
    equal(column(frames, "next.reward").astype("f4"), joint.reward)
    equal(column(frames, "next.done"), joint.terminated | joint.truncated)
    equal(column(frames, "next.terminated"), joint.terminated)
    equal(column(frames, "episode_index"), joint.episode)
    assert column(frames, "frame_index").tolist() == [
        step for length in LENGTHS for step in range(length)
    ]
    equal(column(frames, "timestamp"), column(frames, "frame_index"))  # a step is 1 s
    episodes = parquet.read_table(path / "meta/episodes/chunk-000/file-000.parquet")
    assert tuple(column(episodes, "length")) == LENGTHS
    assert column(episodes, "dataset_to_index").tolist() == [3, 7, 12, 15]
    tasks = parquet.read_table(path / "meta/tasks.parquet")
    assert tasks.schema.pandas_metadata["index_columns"] == ["task"]
    info = json.loads((path / "meta/info.json").read_text())
    assert (info["fps"], info["total_frames"]) == (1, sum(LENGTHS))
    assert [*info["features"]] == frames.column_names
    state, action = (info["features"][k] for k in ("observation.state", "action"))
    assert state["names"] == [*REACH.state_names]
    assert action["names"][::3] == ["end_effector.delta_x", "balance.alpha"]
    stats = json.loads((path / "meta/stats.json").read_text())["action"]
    equal(np.float32(stats["min"]), joint.action.min(axis=0))
    assert stats["q50"] == np.median(joint.action.astype(float), axis=0).tolist()


def test_vaults_stack_agents_and_fill_with_zeros(
    dataset: Dataset, tmp_path: Path
) -> None:
    path = written(dataset, "flashbax", tmp_path)
    import tensorstore

    def leaf(name: str) -> Any:
        base = {"driver": "file", "path": f"{path}/"}
        store = {"driver": "ocdbt", "base": base, "path": name}
        return tensorstore.open({"driver": "zarr", "kvstore": store}).result()

    about = json.loads((path / "metadata.json").read_text())
    count = sum(LENGTHS)
    assert leaf("vault_index").read().result().tolist() == [count]
    assert about["structure_shape"]["actions"] == f"(1, {count}, 2, 3)"
    assert about["structure_shape"]["infos"] == {"state": f"(1, {count}, 10)"}
    joint = dataset.joint()
    equal(leaf("infos.state.")[0, :count].read().result(), joint.observation)
    for number, (name, view) in enumerate(dataset.agents().items()):
        for key, expected in (
            ("observations", view.observation),
            ("actions", view.action),
            ("rewards", joint.reward),
            ("terminals", joint.terminated),
            ("truncations", joint.truncated),
        ):
            values = leaf(f"{key}.")[0, :count, number].read().result()
            if expected.ndim == 2:
                width = about["sizes"][name][key]
                assert width == expected.shape[1] and not values[:, width:].any()
                values = values[:, :width]
            equal(values, expected)


def test_hub_folders_are_datasets_with_card_licence_and_sums(
    dataset: Dataset, tmp_path: Path
) -> None:
    path = written(dataset, "hub", tmp_path)
    lines = (path / "SHA256SUMS").read_text().splitlines()
    sums = {line[66:]: line[:64] for line in lines}
    files = contents(path)
    edited = {"LICENSE", "README.md", "croissant.json"}  # a licence comes into them
    assert {*files} == {*sums, "SHA256SUMS", *edited}
    assert {k: hashlib.sha256(files[k]).hexdigest() for k in sums} == sums
    croissant = json.loads(files["croissant.json"])
    listed = {item["contentUrl"]: item["sha256"] for item in croissant["distribution"]}
    assert listed == sums
    assert load_dataset(str(path)).fingerprint == dataset.fingerprint
    yaml = pytest.importorskip("yaml")
    front = yaml.safe_load((path / "README.md").read_text().split("---\n")[1])
    assert front["license"] == "other" and front["size_categories"] == ["n<1K"]
    assert "No licence is stated" in files["LICENSE"].decode()
    assert str(tmp_path).encode() not in b"".join(files.values())
    assert keep_card(load_dataset(str(path)))["steps"] == dataset.arrays.steps
    assert contents(path) == files


def test_no_hub_folder_is_made_of_data_that_were_replaced(
    dataset: Dataset, tmp_path: Path, make_episode: Callable[..., Episode]
) -> None:
    arrays = arrays_of([make_episode(9, steps=2)], ID)
    write_dataset(dataset.location, arrays, dataset.provenance, overwrite=True)
    with pytest.raises(DatasetError, match="was replaced since it was loaded"):
        export(dataset, "hub", str(tmp_path / "hub"))
    assert not [*tmp_path.glob("*hub*")]


def test_data_of_the_package_have_its_licence(
    datasets_home: Path, tmp_path: Path
) -> None:
    path = written(load_dataset("good-5k"), "hub", tmp_path)
    assert (path / "LICENSE").read_text().startswith("MIT License")
    assert '\nlicense: "mit"\n' in (path / "README.md").read_text()
    lines = (path / "SHA256SUMS").read_text().splitlines()
    assert {*contents(path)} == {*(line[66:] for line in lines), "SHA256SUMS"}


def test_data_that_are_only_called_like_the_packages_have_not(
    datasets_home: Path, tmp_path: Path
) -> None:
    """Of a recipe's name, and of the name of one that ships."""
    for name in ("marl_mm/gate/rare-v0", "marl_mm/reach/good-5k-v0"):
        collect("pd", dataset=name, steps=30, engine="mujoco")
        path = written(load_dataset(name), "hub", tmp_path)
        assert "No licence is stated" in (path / "LICENSE").read_text()
        shutil.rmtree(path)
