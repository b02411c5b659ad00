"""What is an id, what is a path, and where either leads."""

from pathlib import Path

import pytest

from marl_mm.datasets.location import Location, find, known_ids, locate, text_of
from marl_mm.errors import UsageError


@pytest.mark.parametrize("text", ["pd", "pd-v0", "marl_mm/reach/pd-v0"])
def test_a_word_is_short_for_an_id(text: str, datasets_home: Path) -> None:
    folder = datasets_home / "marl_mm/reach/pd-v0"
    assert locate(text) == Location("marl_mm/reach/pd-v0", folder)
    assert locate(text).name == "marl_mm/reach/pd-v0"


def test_a_named_dataset_is_of_its_task(datasets_home: Path) -> None:
    folder = datasets_home / "marl_mm/quiet-zone/one-bad-v0"
    named = Location("marl_mm/quiet-zone/one-bad-v0", folder)
    assert locate("quiet-zone-one-bad") == find("quiet-zone-one-bad") == named
    assert locate("quiet-zone-one").id == "marl_mm/reach/quiet-zone-one-v0"


def test_everything_else_is_a_path(
    datasets_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for text in ("./my set", str(tmp_path / "my set")):
        location = locate(text)
        assert location == Location("marl_mm/local/my-set-v0", tmp_path / "my set")
        assert location.name == str(tmp_path / "my set")
    data = tmp_path / "my set" / "data"
    assert locate(str(data)).folder == data  # a name like any other,
    data.mkdir(parents=True)
    (data / "metadata.json").touch()
    assert locate(str(data)).folder == data.parent  # unless it is Minari's folder


def test_a_path_below_the_root_is_its_id(datasets_home: Path) -> None:
    folder = datasets_home / "marl_mm" / "reach" / "pd-v0"
    assert (
        locate(str(folder)) == locate("pd") == Location("marl_mm/reach/pd-v0", folder)
    )
    assert locate(str(datasets_home / "pd")).id == "marl_mm/local/pd-v0"
    assert locate("marl_mm/reach/pd-v0/") == locate("pd")


def test_a_path_below_a_linked_root_is_its_id(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "disk").mkdir()
    (tmp_path / ".minari").symlink_to(tmp_path / "disk")
    below = "~/.minari/datasets/marl_mm/reach/pd-v0"
    assert locate(below) == locate("pd") and locate("pd").name == locate("pd").id


@pytest.mark.parametrize(
    "text", ["", "/", "marl_mm/reach/pd", "marl_mm/", "marl_mm/a/pd-v0"]
)
def test_no_name_and_half_an_id_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"expected an id or a path|expected marl_mm/"):
        locate(text)


def test_homes_that_nobody_has_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="'~nobody-here/x'"):
        locate("~nobody-here/x")

    def fail() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    monkeypatch.setattr(Path, "home", fail)
    with pytest.raises(UsageError, match=r"home directory\. Set \$HOME"):
        locate("pd")


def test_a_word_is_a_folder_here_only_where_there_is_no_such_id(
    datasets_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    here = tmp_path / "pd" / "data"
    here.mkdir(parents=True)
    (here / "metadata.json").touch()
    assert find("pd").folder == tmp_path / "pd"
    locate("pd").working.mkdir(parents=True)  # a collection that has just begun
    assert find("pd") == locate("pd")


def test_a_path_object_is_never_an_id(
    datasets_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("pd", "gate-expert", "marl_mm/reach/pd-v0"):
        assert locate(text_of(Path(name))).folder == tmp_path / name
        assert locate(text_of(name)).folder == datasets_home / locate(name).id


def test_ids_are_those_of_whole_datasets(datasets_home: Path) -> None:
    assert known_ids() == []
    for name in ("b-v0", "a-v0", ".c-v0.collecting"):
        data = datasets_home / "marl_mm/reach" / name / "data"
        data.mkdir(parents=True)
        (data / "metadata.json").touch()
    (datasets_home / "marl_mm/reach/d-v0/data").mkdir(parents=True)
    assert known_ids() == ["marl_mm/reach/a-v0", "marl_mm/reach/b-v0"]
