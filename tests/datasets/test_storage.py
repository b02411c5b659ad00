"""Datasets: read back bit-equal, whole or not at all, clear about damage."""

import ctypes
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import minari
import numpy as np
import pytest

import marl_mm  # noqa: F401  registers the environments
from marl_mm import temporary
from marl_mm.cli import main
from marl_mm.datasets import cache, catalogue, storage
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.cache import FOLDER_VARIABLE, cache_folder, clear
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import Journal
from marl_mm.datasets.location import find, known_ids, locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import INFO, Episode
from marl_mm.errors import (
    DatasetError,
    OutputExistsError,
    UnknownDatasetError,
    UsageError,
)
from marl_mm.files import new_folder
from marl_mm.layout import Layout

ID = "marl_mm/reach/test-v0"
PROVENANCE = Provenance(task="Reach-v0", collector="pd", seed=0)


@pytest.fixture
def written(datasets_home: Path, episodes: list[Episode]) -> Path:
    write(ID, episodes)
    return datasets_home / ID


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "derived"))
    return cache_folder()


def write(name: str, episodes: list[Episode], overwrite: bool = False) -> None:
    write_dataset(locate(name), arrays_of(episodes, ID), PROVENANCE, overwrite)


def test_reading_back_is_bit_equal(written: Path, episodes: list[Episode]) -> None:
    back = load_dataset(ID).episodes
    assert len(back) == len(episodes)
    for episode, read in zip(episodes, back, strict=True):
        for name in ("states", "actions", "rewards", "terminated", "truncated"):
            expected, actual = getattr(episode, name), getattr(read, name)
            assert expected.dtype == actual.dtype
            np.testing.assert_array_equal(expected, actual)
        assert episode.info.keys() == read.info.keys()
        for key, values in episode.info.items():
            np.testing.assert_array_equal(values, read.info[key])
        assert (episode.seed, episode.index, episode.source) == (
            read.seed,
            read.index,
            read.source,
        )


@pytest.mark.slow
def test_a_card_that_was_cut_off_is_named_and_made_again(written: Path) -> None:
    assert main(["datasets", "show", ID]) == 0
    path = written / "card.json"
    path.write_bytes(path.read_bytes()[:100])
    assert [line.split(" is damaged")[0] for line in verify(locate(ID))] == [str(path)]
    assert main(["datasets", "show", ID]) == 0 and verify(locate(ID)) == []
    path.write_text("[]")
    (problem,) = verify(locate(ID))
    assert problem.startswith(f"{path}: list is not a dict")


def test_minari_reads_it_without_us(written: Path, episodes: list[Episode]) -> None:
    dataset = minari.load_dataset(ID)
    assert dataset.total_episodes == len(episodes)
    assert dataset.total_steps == sum(map(len, episodes))
    first = dataset[0]
    np.testing.assert_array_equal(first.actions, episodes[0].actions)
    np.testing.assert_array_equal(
        first.observations["achieved_goal"], episodes[0].states[:, :3]
    )
    assert ID in minari.list_local_datasets()
    env = dataset.recover_environment()
    assert env.spec is not None
    assert env.spec.id == "marl_mm/Reach-v0"
    assert dataset.observation_space == env.observation_space
    env.close()


def test_scores_normalise_between_random_and_the_best(written: Path) -> None:
    dataset = minari.load_dataset(ID)
    metadata = dataset.storage.metadata
    ends = np.array([metadata["ref_min_score"], metadata["ref_max_score"]])
    np.testing.assert_allclose(minari.get_normalized_score(dataset, ends), [0, 1])


def test_metadata_says_where_each_agents_entries_are(written: Path) -> None:
    metadata = json.loads((written / "data" / "metadata.json").read_text())["marl_mm"]
    layout = metadata["layout"]
    assert layout["state"][5] == ["base_yaw", "rad", None, None]
    assert layout["action"][3] == ["alpha", "1", 0.0, 1.0]
    assert layout["agents"][1][0] == "balance" and layout["agents"][1][2] == ["alpha"]
    assert "goal_x" not in layout["agents"][1][1]
    assert Layout.from_json(layout) == REACH and metadata["info"] == list(INFO)
    assert "pybullet" in metadata["packages"]


def test_joint_view_stacks_the_episodes(written: Path, episodes: list[Episode]) -> None:
    joint = load_dataset(ID).joint()
    assert joint.observation.shape == (sum(map(len, episodes)), 10)
    second = joint.episode == 1
    np.testing.assert_array_equal(joint.observation[second], episodes[1].states[:-1])
    np.testing.assert_array_equal(
        joint.next_observation[second], episodes[1].states[1:]
    )
    assert joint.terminated.sum() == sum(e.success for e in episodes)
    assert joint.truncated.sum() == sum(not e.success for e in episodes)


def test_agent_views_together_are_the_joint_action(written: Path) -> None:
    dataset = load_dataset(ID)
    agents = dataset.agents()
    assert list(agents) == ["end_effector", "balance"]
    joined = np.concatenate([part.action for part in agents.values()], axis=1)
    np.testing.assert_array_equal(joined, dataset.joint().action)
    assert agents["end_effector"].observation.shape[1] == 9
    assert agents["balance"].observation.shape[1] == 7


def test_a_path_is_as_good_as_an_id(
    tmp_path: Path, written: Path, episodes: list[Episode]
) -> None:
    write(str(tmp_path / "mine"), episodes)
    for name in (str(tmp_path / "mine"), str(tmp_path / "mine" / "data"), str(written)):
        assert len(load_dataset(name).episodes) == len(episodes)


def test_an_unknown_id_names_similar_ones(written: Path) -> None:
    with pytest.raises(UnknownDatasetError, match=f"did you mean {ID}?"):
        load_dataset("marl_mm/reach/tests-v0")
    with pytest.raises(UnknownDatasetError, match="datasets list shows all"):
        load_dataset("marl_mm/reach/nothing-v0")


def test_what_killed_writers_left_is_replaced(
    written: Path, episodes: list[Episode]
) -> None:
    """But nothing that somebody else put there."""
    (written / "cache").mkdir()  # version 1 kept arrays there
    for name in (
        ".card.123.png",
        ".card.4.json",
        f".card.{0:016x}.part.md",
        "cache/.a.5.npz",
    ):
        (written / name).write_text("half")
    write(ID, episodes[:2], overwrite=True)
    assert not (written / ".card.123.png").exists()
    (written / "notes.png").write_text("mine")
    with pytest.raises(UsageError, match="holds other files"):
        write(ID, episodes, overwrite=True)


def test_an_empty_name_is_refused() -> None:
    with pytest.raises(UsageError, match="empty"):
        locate("")


def test_nothing_is_overwritten_unasked(written: Path, episodes: list[Episode]) -> None:
    before = (written / "data" / "main_data.hdf5").read_bytes()
    with pytest.raises(OutputExistsError, match="`overwrite=True`"):
        write(ID, episodes[:2])
    assert (written / "data" / "main_data.hdf5").read_bytes() == before
    write(ID, episodes[:2], overwrite=True)
    assert len(load_dataset(ID).episodes) == 2
    assert [p.name for p in written.parent.iterdir() if p.name.startswith(".")] == []


def test_linked_folders_are_listed_and_circles_are_not_walked(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As those of data on a larger disk."""
    root = tmp_path / "another"
    root.mkdir()
    (root / "linked").symlink_to(written.parent)
    (root / "back").symlink_to(root)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    assert known_ids() == [f"linked/{written.name}"]
    shutil.copytree(written, root / "plain")
    notes = {row["id"]: row["note"] for row in catalogue.catalogue()}
    assert notes[known_ids()[0]] == "" and "named by its path" in notes["plain"]
    with pytest.raises(UnknownDatasetError) as raised:
        load_dataset("plain")
    assert "did you mean" not in str(raised.value)


def test_overwrite_replaces_datasets_and_nothing_else(
    tmp_path: Path, episodes: list[Episode]
) -> None:
    thesis = tmp_path / "work" / "thesis.txt"
    thesis.parent.mkdir()
    thesis.write_text("years")
    with pytest.raises(UsageError, match="holds other files"):
        write(str(tmp_path / "work"), episodes, overwrite=True)
    with pytest.raises(UsageError, match="is no dataset"):
        write(str(thesis), episodes, overwrite=True)
    assert thesis.read_text() == "years"


def test_a_failed_replacement_keeps_what_was_there(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    target.mkdir()
    (target / "old").write_text("old")
    with pytest.raises(OSError), new_folder(target) as temporary:
        (temporary / "new").write_text("new")
        raise OSError("disk full")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert (target / "old").read_text() == "old"
    with new_folder(target) as temporary:
        (temporary / "new").write_text("new")
    assert [path.name for path in target.iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_folder_is_replaced_where_names_cannot_be_exchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusing = SimpleNamespace(renameat2=lambda *names: -1)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: refusing)
    for text in ("one", "two"):
        with new_folder(tmp_path / "folder") as temporary:
            (temporary / "file").write_text(text)
        assert (tmp_path / "folder/file").read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_waiting_writers_take_turns_though_each_removes_the_folder(
    tmp_path: Path,
) -> None:
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from marl_mm.files import only_here\n"
        "folder = Path(sys.argv[1])\n"
        "for _ in range(200):\n"
        "    with only_here(folder, wait=True):\n"
        "        (folder / 'mine').touch(exist_ok=False)\n"
        "        (folder / 'mine').unlink()\n"
        "        folder.rmdir()\n"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "taken")]
    processes = [subprocess.Popen(words) for _ in range(4)]
    assert [process.wait() for process in processes] == [0] * 4


def test_a_word_is_an_id_unless_it_is_a_dataset_here(
    datasets_home: Path,
    episodes: list[Episode],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert locate("word") == locate("marl_mm/reach/word-v0")
    assert locate("word-v3").id == "marl_mm/reach/word-v3"
    assert locate("./word").folder == tmp_path / "word"
    Path("word").mkdir()  # no dataset: hides nothing
    assert find("word") == locate("word")
    Path("word").rmdir()
    write("./word", episodes)
    assert find("word") == locate("./word")
    with Journal(locate("word").working):  # a collection that was stopped
        assert find("word") == locate("word")
    shutil.rmtree(locate("word").working)
    write("word", episodes)
    assert find("word") == locate("word")


def test_an_empty_dataset_is_refused(datasets_home: Path) -> None:
    with pytest.raises(DatasetError, match="no episode"):
        write(ID, [])
    assert known_ids() == []


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_file_is_named(written: Path, share: float) -> None:
    path = written / "data" / "main_data.hdf5"
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(
        DatasetError, match=r"main_data.hdf5 is damaged.*datasets delete"
    ):
        load_dataset(ID)


def test_one_bit_more_or_less_is_seen(written: Path) -> None:
    path = written / "data" / "main_data.hdf5"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    with pytest.raises(DatasetError, match="not those that were written"):
        load_dataset(ID)
    path = written / "data" / "metadata.json"
    path.write_text(path.read_text().replace('"seed": 0', '"seed": 1'))
    with pytest.raises(DatasetError, match="not as it was written"):
        load_dataset(ID)


@pytest.mark.slow
def test_the_cache_is_only_a_cache(
    written: Path, episodes: list[Episode], own_cache: Path
) -> None:
    """Missing or damaged it is made anew; of other data it is not used."""
    load_dataset(ID)
    (entry,) = own_cache.iterdir()
    good = entry.read_bytes()
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 8
    for content in (None, b"", good[: len(good) // 2], b"no zip", bytes(flipped)):
        if content is None:
            entry.unlink()
        else:
            entry.write_bytes(content)
        joint = load_dataset(ID).joint()
        np.testing.assert_array_equal(joint.reward[:3], episodes[0].rewards)
        assert entry.read_bytes() == good
    write(ID, episodes[1:], overwrite=True)
    assert len(load_dataset(ID).episodes) == len(episodes) - 1
    assert len([*own_cache.iterdir()]) == 2 and not (written / "cache").exists()
    machine = temporary._machine()
    left = own_cache / f".{entry.stem}.{machine}01234567.part.npz"
    for path in (left, own_cache / "mine.txt"):
        path.touch()
    clear()
    assert [path.name for path in own_cache.iterdir()] == ["mine.txt"]


def test_a_deletion_that_was_cut_off_can_be_made_again(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (written / "card.json").touch()

    def stop(path: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(shutil, "rmtree", stop)
        catalogue.delete(locate(ID))
    assert not (written / "card.json").exists()
    catalogue.delete(locate(ID))
    assert not written.exists()


@pytest.mark.slow
def test_a_cache_of_somebody_else_is_read(
    written: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    first = load_dataset(ID)
    monkeypatch.setattr(os, "utime", refuse)
    monkeypatch.setattr(storage, "read_apart", refuse)  # the slow way
    assert load_dataset(ID).fingerprint == first.fingerprint
    assert load_dataset(ID) != first, "arrays are not compared"


def test_data_that_are_replaced_while_they_are_read_are_not_called_damaged(
    written: Path, episodes: list[Episode]
) -> None:
    metadata = read_metadata(locate(ID))
    write(ID, episodes[1:], overwrite=True)
    with pytest.raises(DatasetError, match="was replaced while it was read"):
        storage.read_arrays(locate(ID), metadata)


@pytest.mark.parametrize("name", ["states", "actions", "rewards"])
def test_a_nan_is_not_written(
    datasets_home: Path, episodes: list[Episode], name: str
) -> None:
    getattr(episodes[0], name).flat[0] = np.nan
    with pytest.raises(DatasetError, match=f"1 {name} with a NaN"):
        write(ID, episodes)
    assert not (datasets_home / ID).exists()


def test_views_share_memory_with_the_whole(written: Path) -> None:
    dataset = load_dataset(ID)
    joint, agents = dataset.joint(), dataset.agents()
    for name in ("reward", "terminated", "truncated"):
        for view in agents.values():
            assert np.shares_memory(getattr(view, name), getattr(joint, name))
    for view in agents.values():
        assert np.shares_memory(view.action, joint.action)
    assert np.shares_memory(agents["balance"].observation, joint.observation)
    assert np.shares_memory(dataset.episodes[2].actions, joint.action)


def test_what_is_printed_beside_the_reading_of_a_file_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: Path
) -> None:
    """As an installed plug-in may greet."""
    (tmp_path / "sitecustomize.py").write_text("print('welcome')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("MARL_MM_CACHE_GB", "0")
    assert len(load_dataset(ID).episodes) > 0
    data = written / "data" / "main_data.hdf5"
    data.write_bytes(data.read_bytes()[:-100])
    with pytest.raises(DatasetError, match=str(data)):
        _ = load_dataset(ID).episodes


@pytest.mark.parametrize(
    "content",
    [
        *("{", "{}", "[1]", '{"marl_mm": {"schema": 99}}'),
        *(f'{{"marl_mm": {{"schema": 2, "state": {x}}}}}' for x in ("5", "[1, 2]")),
    ],
)
def test_foreign_or_damaged_metadata_are_named(written: Path, content: str) -> None:
    (written / "data" / "metadata.json").write_text(content)
    with pytest.raises(DatasetError, match=r"metadata.json"):
        load_dataset(ID)


def test_a_killed_writer_leaves_nothing_behind(datasets_home: Path) -> None:
    """Killed in the middle of writing: no dataset, and the id is free."""
    code = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from conftest import build_episode
from marl_mm.datasets import hdf5
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.location import known_ids, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset

written = []
attributes = hdf5._attributes

def killing(arrays, number):
    written.append(number)
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return attributes(arrays, number)

hdf5._attributes = killing
arrays = arrays_of([build_episode(i) for i in range(5)], "marl_mm/reach/test-v0")
provenance = Provenance(task="Reach-v0", collector="pd")
write_dataset(locate("marl_mm/reach/test-v0"), arrays, provenance)
"""
    killed = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parents[1])],
        env={**os.environ, "MINARI_DATASETS_PATH": str(datasets_home)},
        capture_output=True,
        check=False,
    )
    assert killed.returncode == -9
    assert known_ids() == []
    with pytest.raises(UnknownDatasetError):
        load_dataset(ID)


def test_what_is_read_again_counts_as_used_last(written: Path, own_cache: Path) -> None:
    """So that it is the last to be deleted."""
    load_dataset(ID)
    (entry,) = cache.entries()
    os.utime(entry.path, (0, 0))
    load_dataset(ID)
    (again,) = cache.entries()
    assert again.path == entry.path and again.used >= entry.used
