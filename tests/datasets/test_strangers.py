"""Files from strangers: nothing in them is believed before it is checked.

Each test is an attack that once worked.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.datasets import cache, convert
from marl_mm.datasets.arrays import arrays_of, save_arrays
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.hdf5 import FILE
from marl_mm.datasets.location import locate
from marl_mm.datasets.metadata import sign_metadata
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError
from marl_mm.received import (
    check_kind,
    check_plain,
    damage_named,
    file_digest,
    parse_json,
    refuse_links_out,
)

Output = pytest.CaptureFixture[str]
pytestmark = pytest.mark.usefixtures("drawn")


@pytest.fixture
def gift(tmp_path: Path, episodes: list[Episode]) -> Path:
    """A dataset that somebody sent, which was never read here."""
    location = locate(str(tmp_path / "gift"))
    provenance = Provenance(
        task="Reach-v0", collector="pd", seed=0, origins={location.id: Origin()}
    )
    write_dataset(location, arrays_of(episodes, location.id), provenance)
    cache.clear()
    return location.folder


def sign(gift: Path) -> None:
    """Compute both hashes anew, as anybody can."""
    path = gift / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    digest = file_digest(gift / "data" / FILE, DatasetError)
    metadata["marl_mm"]["data_sha256"] = digest
    path.write_text(json.dumps(metadata))
    sign_metadata(path)


def tamper(gift: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = gift / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    change(metadata)
    path.write_text(json.dumps(metadata))
    sign(gift)


def refused(gift: Path, match: str, capsys: Output) -> None:
    """``show`` and ``verify`` refuse it in one line, and write nothing."""
    before = sorted(gift.rglob("*"))
    for command in ("show", "verify"):
        capsys.readouterr()
        assert main(["datasets", command, str(gift)]) == 1
        output = capsys.readouterr()
        assert match in output.err + output.out
        assert output.err.count("\n") == 1 and "Traceback" not in output.err
    assert sorted(gift.rglob("*")) == before


# --- The cache ---------------------------------------------------------------


def test_a_forged_cache_in_a_datasets_folder_is_ignored(
    gift: Path, episodes: list[Episode], capsys: Output
) -> None:
    arrays = arrays_of(episodes, "x")
    arrays.rewards[:] = 10_000.0
    arrays.lengths[0] = -1
    (gift / "cache").mkdir()
    digest = json.loads((gift / "data/metadata.json").read_text())["marl_mm"]
    for name in (digest["data_sha256"][:16], "any"):
        save_arrays(gift / "cache" / f"{name}.npz", arrays, compress=False)
    np.testing.assert_array_equal(
        load_dataset(str(gift)).arrays.rewards, arrays_of(episodes, "x").rewards
    )
    assert main(["datasets", "show", str(gift)]) == 0


def test_a_cache_that_is_a_link_costs_nobody_a_file(
    gift: Path, tmp_path: Path, capsys: Output
) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "mine.npz").write_text("precious")
    (gift / "cache").symlink_to(victim)
    refused(gift, "is a link out of its folder", capsys)
    assert [path.name for path in victim.iterdir()] == ["mine.npz"]


def test_the_cache_stays_below_its_bound(
    gift: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Output
) -> None:
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "own"))
    size = load_dataset(str(gift)).arrays.nbytes
    (entry,) = cache.entries()
    for number in range(4):
        old = entry.path.with_name(f"old-{number}.npz")
        shutil.copy(entry.path, old)
        os.utime(old, (number, number))
    monkeypatch.setenv(cache.SIZE_VARIABLE, str(3.9 * entry.size / 1e9))
    entry.path.unlink()
    load_dataset(str(gift))
    names = {each.path.name for each in cache.entries()}
    assert names == {entry.path.name, "old-3.npz", "old-2.npz"}
    assert sum(each.size for each in cache.entries()) <= 3.9 * entry.size
    assert main(["cache", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["entries"] == 3 and shown["folder"] == str(tmp_path / "own/datasets")
    assert main(["cache", "--clear"]) == 0 and cache.entries() == []
    monkeypatch.setenv(cache.SIZE_VARIABLE, str(size / 2e9))
    load_dataset(str(gift))
    assert cache.entries() == []
    monkeypatch.setenv(cache.SIZE_VARIABLE, "much")
    assert main(["cache"]) == 2
    assert "expected a size in GB" in capsys.readouterr().err


# --- Links and files that are none -------------------------------------------


@pytest.mark.parametrize("name", ["data", f"data/{FILE}", "data/metadata.json"])
def test_links_that_leave_the_folder_are_refused(
    gift: Path, tmp_path: Path, capsys: Output, name: str
) -> None:
    (gift / name).rename(tmp_path / "elsewhere")
    (gift / name).symlink_to(tmp_path / "elsewhere")
    refused(gift, "is a link out of its folder", capsys)
    words = ["datasets", "import", str(gift), "--out", str(tmp_path / "imported")]
    assert main(words) == 1
    assert "is a link out of its folder" in capsys.readouterr().err


def test_a_linked_dataset_is_read_and_only_the_link_deleted(
    gift: Path, tmp_path: Path, capsys: Output
) -> None:
    link = tmp_path / "link"
    link.symlink_to(gift)
    assert main(["datasets", "verify", str(link)]) == 0
    assert main(["datasets", "delete", str(link), "--yes"]) == 0
    assert f"deleted the link {link}; {gift}, where it led" in capsys.readouterr().out
    assert not link.is_symlink() and verify(locate(str(gift))) == []


def test_an_id_that_is_a_link_is_deleted_likewise(
    gift: Path, datasets_home: Path, capsys: Output
) -> None:
    link = datasets_home / "marl_mm/reach/linked-v0"
    link.parent.mkdir(parents=True)
    link.symlink_to(gift)
    assert main(["datasets", "delete", "linked", "--yes"]) == 0
    assert not link.is_symlink() and verify(locate(str(gift))) == []


@pytest.mark.parametrize("name", [f"data/{FILE}", "data/metadata.json"])
@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_what_is_no_regular_file_is_refused_at_once(
    gift: Path, capsys: Output, name: str, kind: str
) -> None:
    (gift / name).unlink()
    {"pipe": os.mkfifo, "folder": os.mkdir}[kind](gift / name)
    refused(gift, f"is a {kind}, expected a regular file", capsys)


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_checkpoints_that_are_no_regular_files_are_refused_at_once(
    tmp_path: Path, capsys: Output, kind: str
) -> None:
    path = tmp_path / "checkpoint.pt"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    for words in (["eval", str(path)], ["check", str(path)]):
        capsys.readouterr()
        assert main(words) == 1
        output = capsys.readouterr()
        assert "expected a regular file" in output.err + output.out


@pytest.mark.parametrize("name", ["checkpoint.pt", "policy.safetensors"])
def test_policies_that_are_links_out_of_their_folder_are_refused(
    tmp_path: Path, capsys: Output, name: str
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (tmp_path / "elsewhere").write_text("anything")
    (run / name).symlink_to(tmp_path / "elsewhere")
    (run / "config.json").write_text("{}")
    for words in (["eval", str(run)], ["check", str(run)]):
        capsys.readouterr()
        assert main(words) == 1
        output = capsys.readouterr()
        assert "is a link out of its folder" in output.err + output.out


# --- HDF5 --------------------------------------------------------------------


def external_link(group: Any, secret: Path) -> None:
    with h5py.File(secret.with_suffix(".hdf5"), "w") as other:
        other["x"] = group["rewards"][()]
    del group["rewards"]
    group["rewards"] = h5py.ExternalLink(str(secret.with_suffix(".hdf5")), "/x")


def soft_link(group: Any, secret: Path) -> None:
    group["copy"] = group["rewards"][()]
    del group["rewards"]
    group["rewards"] = h5py.SoftLink(f"{group.name}/copy")


def external_storage(group: Any, secret: Path) -> None:
    shape = group["rewards"].shape
    secret.write_bytes(bytes(8 * shape[0]))
    del group["rewards"]
    group.create_dataset("rewards", shape, "f8", external=[(secret, 0, 8 * shape[0])])


def virtual(group: Any, secret: Path) -> None:
    shape = group["rewards"].shape
    del group["rewards"]
    layout = h5py.VirtualLayout(shape, "f8")
    layout[...] = h5py.VirtualSource(secret, "x", shape)
    group.create_virtual_dataset("rewards", layout)


def linked_group(group: Any, secret: Path) -> None:
    group.move("observations", "elsewhere")
    group["observations"] = h5py.SoftLink(f"{group.name}/elsewhere")


OUTSIDE = [external_storage, virtual]
ATTACKS = [external_link, soft_link, linked_group, *OUTSIDE]


@pytest.mark.parametrize("attack", ATTACKS)
def test_data_that_lie_elsewhere_are_refused(
    gift: Path, tmp_path: Path, capsys: Output, attack: Callable[[Any, Path], None]
) -> None:
    path = gift / "data" / FILE
    with h5py.File(path, "r+") as file:
        attack(file["episode_0"], tmp_path / "secret.bin")
    sign(gift)
    words = "stored in other files" if attack in OUTSIDE else "another place"
    refused(gift, words, capsys)
    out = str(tmp_path / "imported")
    capsys.readouterr()
    assert main(["datasets", "import", str(path), "--out", out]) == 1
    assert words in capsys.readouterr().err
    assert not Path(out).exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("actions", 7.0, "outside of the action space"),
        ("terminations", True, "end an episode before its last"),
        ("truncations", True, "end an episode before its last"),
        ("observations/desired_goal", 0.3, "goals that move"),
        ("rewards", 1e308, "1 rewards beyond 1e+12"),
    ],
)
def test_implausible_episodes_are_refused_though_signed(
    gift: Path, capsys: Output, key: str, value: float, match: str
) -> None:
    with h5py.File(gift / "data" / FILE, "r+") as file:
        file[f"episode_0/{key}"][0] = value
    sign(gift)
    refused(gift, match, capsys)
    words = ["train", "mabc", "--dataset", str(gift), "--out", str(gift / "../runs")]
    assert main(words) == 1 and match in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("truncations", True, "1 steps that are both terminated and truncated"),
        ("terminations", False, "1 episodes that neither reached the goal nor ran"),
    ],
)
def test_ends_that_cannot_be_are_refused_though_signed(
    gift: Path,
    capsys: Output,
    key: str,
    value: bool,
    match: str,
) -> None:
    with h5py.File(gift / "data" / FILE, "r+") as file:
        file[f"episode_0/{key}"][-1] = value
    sign(gift)
    refused(gift, match, capsys)


def unread_storage(group: Any, secret: Path) -> None:
    secret.write_bytes(bytes(80))
    group.create_dataset("unread", (10,), "f8", external=[(secret, 0, 80)])


def unread_link(group: Any, secret: Path) -> None:
    group.file["unread"] = h5py.ExternalLink(str(secret), "/")


def repeated_group(group: Any, secret: Path) -> None:
    group.file["unread"] = group


def repeated_array(group: Any, secret: Path) -> None:
    group["infos/again"] = group["rewards"]


@pytest.mark.parametrize(
    ("attack", "match"),
    [
        (unread_storage, "unread is stored in other files"),
        (unread_link, "unread is a link to another place"),
        (repeated_group, "is an object of several names"),
        (repeated_array, "is an object of several names"),
    ],
)
def test_what_is_not_read_is_looked_at_too(
    gift: Path, tmp_path: Path, capsys: Output, attack: Callable[..., None], match: str
) -> None:
    path = gift / "data" / FILE
    with h5py.File(path, "r+") as file:
        attack(file["episode_0"], tmp_path / "secret.bin")
    sign(gift)
    refused(gift, match, capsys)
    out = str(tmp_path / "imported")
    assert main(["datasets", "import", str(path), "--out", out]) == 1
    assert match in capsys.readouterr().err and not Path(out).exists()


def test_episodes_beyond_those_of_the_metadata_are_refused(
    gift: Path, episodes: list[Episode], capsys: Output
) -> None:
    def change(metadata: dict[str, Any]) -> None:
        metadata["total_episodes"] = metadata["marl_mm"]["episodes"] = 1

    tamper(gift, change)
    refused(gift, f"has {len(episodes)} episodes, expected 1", capsys)


def start_far_away(group: Any) -> None:
    start = group.attrs["initial_configuration"]
    start[0] = 1e300
    group.attrs["initial_configuration"] = start


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda group: group.attrs.__setitem__("seed", -1), "1 seeds below 0"),
        (
            lambda group: group.attrs.__setitem__("seed", np.uint64(2**64 - 1)),
            f"{FILE}, episode_0: 'seed' is 18446744073709551615, expected an integer",
        ),
        (start_far_away, "1 starts beyond 1e+12"),
    ],
)
def test_implausible_attributes_are_refused_though_signed(
    gift: Path, capsys: Output, change: Callable[[Any], None], match: str
) -> None:
    with h5py.File(gift / "data" / FILE, "r+") as file:
        change(file["episode_0"])
    sign(gift)
    refused(gift, match, capsys)


@pytest.mark.slow
def test_a_seed_that_is_none_counts_as_unknown_when_imported(
    gift: Path, tmp_path: Path
) -> None:
    with h5py.File(gift / "data" / FILE, "r+") as file:
        for name, seed in (("episode_0", -5), ("episode_1", np.uint64(2**64 - 1))):
            file[name].attrs["seed"] = seed
    out = str(tmp_path / "imported")
    assert main(["datasets", "import", str(gift / "data" / FILE), "--out", out]) == 0
    assert load_dataset(out).arrays.seeds[:2].tolist() == [-1, -1]
    assert verify(locate(out)) == []


# --- Bombs -------------------------------------------------------------------

_LIMITED = """
import resource, sys, time
from marl_mm.cli import main
begin = time.monotonic()
code = main(sys.argv[1:])
(own,) = (  # not ru_maxrss, which counts the process that started this one
    int(line.split()[1]) for line in open("/proc/self/status") if "VmHWM" in line
)
children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
memory = max(own, children) / 1024
print(f"|{code} {time.monotonic() - begin:.1f} {memory:.0f}", file=sys.stdout)
"""


def cheap(*words: str) -> tuple[int, float, str]:
    """Exit code, memory [MB] and complaint of a command in a process of its own."""
    ended = subprocess.run(
        [sys.executable, "-c", _LIMITED, *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    code, _, memory = ended.stdout.rpartition("|")[2].split()
    assert "Traceback" not in ended.stderr
    return int(code), float(memory), ended.stderr


def declared_rows(file: Any) -> None:
    del file["episode_0/rewards"]
    chunks = {"chunks": (100_000,), "compression": "gzip"}
    file.create_dataset("episode_0/rewards", (10**11,), "f8", **chunks)


def packed_zeros(file: Any) -> None:
    del file["episode_0/infos/d_mm"]
    values = np.zeros(20_000_000)
    file.create_dataset("episode_0/infos/d_mm", data=values, compression="gzip")


def sum_of_rows(file: Any) -> None:
    """Each array is as large as one may be, all together are 12 GB."""
    for number in range(200):
        file.create_dataset(f"episode_0/{number}", (7_500_000,), "f8", chunks=(10**6,))


def many_episodes(file: Any) -> None:
    for number in range(10, 100_010):  # without opening the object each time
        name = f"episode_{number}".encode()
        file.id.links.create_hard(name, file.id, b"episode_0")


@pytest.mark.slow
@pytest.mark.parametrize(
    "bomb", [declared_rows, packed_zeros, sum_of_rows, many_episodes]
)
def test_bombs_in_data_are_refused_cheaply(
    gift: Path, tmp_path: Path, bomb: Callable[[Any], None]
) -> None:
    with h5py.File(gift / "data" / FILE, "r+") as file:
        bomb(file)
    if bomb is many_episodes:
        tamper(gift, lambda metadata: metadata["marl_mm"].update(episodes=1_000_000))
    sign(gift)
    out = str(tmp_path / "imported")
    for words in (["show", str(gift)], ["import", str(gift), "--out", out]):
        code, memory, error = cheap("datasets", *words)
        assert code == 1 and error.count("\n") == 1, error
        assert memory < 500
    assert not Path(out).exists()


@pytest.mark.slow
def test_a_text_that_is_repeated_fills_no_memory(tmp_path: Path) -> None:
    """3,000 texts of 1 MB each, which are one in the file."""
    path = tmp_path / "texts.hdf5"
    texts = np.array(["x" * 1_000_000, *["y"] * 2_999], object)
    with h5py.File(path, "w") as file:
        file["rewards"] = np.zeros(5)
        file.attrs["task"] = "Reach-v0"
        file.attrs.create("texts", texts, dtype=h5py.string_dtype())
    content = path.read_bytes()
    begin = content.index((1_000_000).to_bytes(4, "little"))
    first = content[begin : begin + 16]  # its length and place
    path.write_bytes(content[:begin] + 3_000 * first + content[begin + 48_000 :])
    out = tmp_path / "imported"
    code, memory, error = cheap("datasets", "import", str(path), "--out", str(out))
    assert code == 1 and error.count("\n") == 1, error
    assert memory < 500 and not out.exists()


def test_metadata_of_a_gigabyte_are_not_read(gift: Path, capsys: Output) -> None:
    os.truncate(gift / "data" / "metadata.json", 10**9)
    refused(gift, "1,000,000,000 bytes, expected at most", capsys)


def test_metadata_are_bounded_by_what_ours_need(gift: Path, capsys: Output) -> None:
    text = "[" + "[]," * 400_000 + "[]]"
    (gift / "data" / "metadata.json").write_text(text)
    refused(gift, "1,200,004 bytes, expected at most 1,000,000", capsys)


def test_values_of_a_record_are_counted_before_they_are_built(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(json, "loads", None)
    with pytest.raises(DatasetError, match="it has more than 3,000,000 values"):
        parse_json("[" + "[]," * 1_500_001 + "[]]", "it", DatasetError)


def test_deep_nesting_is_refused(gift: Path, capsys: Output) -> None:
    (gift / "data" / "metadata.json").write_text("[" * 200_000 + "]" * 200_000)
    refused(gift, "recursion", capsys)


# --- Metadata ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda m: m["marl_mm"].update(collector="\x1b]0;title\x07"), "control"),
        (lambda m: m["marl_mm"].update(collector="a\rb"), "control"),
        (lambda m: m.update(dataset_id="../../x"), "expected an id"),
        (lambda m: m["marl_mm"].update(task=None), "task"),
        (lambda m: m["marl_mm"].update(overrides=[1]), "overrides"),
        (lambda m: m["marl_mm"].update(origins=3), "origins"),
        (lambda m: m["marl_mm"].update(attempts="x"), "attempts"),
        (lambda m: m["marl_mm"].update(attempts=10**12), "attempts"),
        (lambda m: m["marl_mm"].update(episodes=-1), "at least 1"),
        (lambda m: m["marl_mm"].update(episodes=1), "but episodes 1"),
        (lambda m: m["marl_mm"].update(steps=1), "steps is 1, but the episodes"),
        (lambda m: m.update(total_steps=1), "total_steps is 1, but the episodes"),
        (lambda m: m["marl_mm"].update(task="<b>"), "task is '<b>', expected a letter"),
        (lambda m: m["marl_mm"]["overrides"].update(max_steps=-1), "max_steps is -1"),
        (lambda m: m["marl_mm"]["overrides"].update(max_steps=2.5), "max_steps is 2.5"),
        (lambda m: m["marl_mm"]["info"].append("is_success"), "a step number twice"),
        (lambda m: m["marl_mm"]["overrides"].update(simulation=5), "simulation: int"),
        (
            lambda m: m["marl_mm"].update(config={"simulation": {"engine": ["x"]}}),
            "simulation.engine",
        ),
        *(
            (lambda m, key=key: m["marl_mm"].pop(key), key)
            for key in ("data_sha256", "episodes", "steps", "statistics", "task")
        ),
    ],
)
def test_metadata_that_cannot_be_ours_are_refused(
    gift: Path, capsys: Output, change: Callable[[dict[str, Any]], Any], match: str
) -> None:
    path = gift / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    change(metadata)
    path.write_text(json.dumps(metadata))
    sign_metadata(path)
    refused(gift, match, capsys)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"task": "GraspReach-v0"}, "another layout than GraspReach-v0: state "),
        ({"overrides": {"no_such": 1}}, "make no Reach-v0: unknown field 'no_such'"),
    ],
)
def test_another_tasks_name_is_found(
    gift: Path, change: dict[str, Any], match: str
) -> None:
    tamper(gift, lambda metadata: metadata["marl_mm"].update(change))
    assert [match in problem for problem in verify(locate(str(gift)))] == [True]


@pytest.mark.slow
@pytest.mark.parametrize("recipe", [{"counts": 3}, {"counts": ["a", None]}])
def test_a_recipe_of_any_keys_is_shown(
    gift: Path, capsys: Output, recipe: dict[str, Any]
) -> None:
    tamper(gift, lambda metadata: metadata["marl_mm"].update(recipe=recipe))
    assert main(["datasets", "show", str(gift)]) == 0
    assert re.search(r"^recipe +counts: ", capsys.readouterr().out, re.MULTILINE)
    assert "counts: " in load_dataset(str(gift))._repr_html_()


def test_a_line_break_makes_no_row_of_a_card(gift: Path, capsys: Output) -> None:
    name = "pd\nreturn  1000.0"
    tamper(gift, lambda metadata: metadata["marl_mm"].update(collector=name))
    for words in ([], ["--markdown"]):
        assert main(["datasets", "show", str(gift), *words]) == 0
        assert "pd return  1000.0" in capsys.readouterr().out


def test_a_folder_in_the_cards_place_is_named(gift: Path) -> None:
    (gift / "card.json").mkdir()
    assert verify(locate(str(gift))) == [
        f"{gift / 'card.json'} is a folder, expected a file: delete it"
    ]


_ODD_NAMES = ("a\x1b[31m\x1b]0;title\x07-v0", "a\u202eb-v0", "a\n  b-v0")


@pytest.mark.parametrize("name", _ODD_NAMES)
@pytest.mark.parametrize("kind", ["dataset", "collection"])
def test_names_of_folders_are_spelled_out(
    gift: Path, datasets_home: Path, capsys: Output, name: str, kind: str
) -> None:
    folder = datasets_home / "marl_mm"
    folder.mkdir(parents=True)
    if kind == "dataset":
        shutil.copytree(gift, folder / name)
    else:
        (folder / f".{name}.collecting").mkdir()
        (folder / f".{name}.collecting" / "episodes.sqlite").write_bytes(b"")
    assert main(["datasets", "list"]) == 0
    shown = capsys.readouterr().out
    assert f"marl_mm/{ascii(name)[1:-1]} " in shown
    assert not {"\x1b", "\x07", "\u202e"} & set(shown) and "\n  b" not in shown


@pytest.mark.slow
def test_a_card_of_other_data_is_named(gift: Path) -> None:
    assert main(["datasets", "show", str(gift)]) == 0
    path = gift / "card.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | {"steps": 1_000_000}))
    assert ["is of other data" in line for line in verify(locate(str(gift)))] == [True]
    assert main(["datasets", "show", str(gift)]) == 0
    assert verify(locate(str(gift))) == []


@pytest.mark.slow
def test_names_are_shown_as_text(gift: Path, capsys: Output) -> None:
    """In Markdown no cell, picture or HTML begins, in a terminal no style."""
    name = "![t](http://127.0.0.1/x) <b>|[red]`"
    tamper(gift, lambda metadata: metadata["marl_mm"].update(collector=name))
    assert main(["datasets", "show", str(gift), "--markdown"]) == 0
    shown = capsys.readouterr().out
    assert r"!\[t\](http://127.0.0.1/x) &lt;b>\|\[red\]\`" in shown
    assert main(["datasets", "show", str(gift)]) == 0
    assert name in capsys.readouterr().out


def test_records_are_read_to_sixty_levels() -> None:
    parse_json("[" * 60 + "0" + "]" * 60, "x", DatasetError)
    for depth in (61, 100_000):
        with pytest.raises(DatasetError, match=r"60 levels|is damaged"):
            parse_json("[" * depth + "0" + "]" * depth, "x", DatasetError)


@pytest.mark.parametrize(
    "value", [{"\x1b[2J": 1}, [{"a": ["\x1b"]}], ({"\x1b"},), [frozenset("\x1b")]]
)
def test_control_characters_are_found_in_names_and_sets_too(value: Any) -> None:
    with pytest.raises(DatasetError, match="it holds control characters"):
        check_plain(value, "it", DatasetError)


@pytest.mark.parametrize(
    ("value", "kind"),
    [([1, 2, "3"], list[int]), ({"a": 1.0, "b": "2"}, dict[str, float])],
)
def test_all_items_are_of_their_type_and_not_the_first_alone(
    value: Any, kind: Any
) -> None:
    with pytest.raises(DatasetError, match=r"it: .*(item 2|value of key 'b')"):
        check_kind(value, kind, "it", DatasetError)


@pytest.mark.parametrize("there", ["a", "b", "gone", "../gone"])
def test_links_in_a_circle_or_to_nothing_lead_nowhere(
    tmp_path: Path, there: str
) -> None:
    (tmp_path / "a").symlink_to(there)
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(DatasetError, match="is a link that leads nowhere"):
        refuse_links_out(tmp_path, ["a"], DatasetError)


def test_a_file_that_is_never_read_through_is_damaged(
    gift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spin = """
        from marl_mm.datasets import convert
        convert.read_hdf5 = lambda *_: all(iter(lambda: 1, 0))
        convert.reading_limits = lambda size: (2, 1_000_000_000)
        convert.main()
    """
    monkeypatch.setattr(convert, "_CODE", textwrap.dedent(spin))
    with pytest.raises(DatasetError, match="takes over 30 s of the processor"):
        _ = load_dataset(str(gift)).arrays


@pytest.mark.parametrize("odd", [OverflowError, ZeroDivisionError, KeyError, TypeError])
def test_errors_at_odd_values_are_damage(odd: type[Exception]) -> None:
    with pytest.raises(DatasetError, match="it is damaged"):
        with damage_named("it", DatasetError):
            raise odd
