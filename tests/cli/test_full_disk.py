"""On a full disk every command ends with one line and leaves no part of a file.

The operating system lets no file grow beyond some size here, which fails as a full disk
does: in Python, in the libraries that write files of their own, and in ffmpeg.
"""

import errno
import os
import resource
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import imageio_ffmpeg
import numpy as np
import pytest

from marl_mm import cli
from marl_mm.algorithms.checkpoint import save_seed
from marl_mm.algorithms.loggers import CsvLogger, TensorBoardLogger
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.runlog import METRICS, RunLog
from marl_mm.cli import main
from marl_mm.datasets import cache, hdf5_files
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.registry import make_task
from marl_mm.episode import Episode
from marl_mm.errors import MarlMmError
from marl_mm.eval.video import film_strip, write_video
from marl_mm.files import append, new_file, new_folder, write_json
from marl_mm.processes import process_context

ID = "marl_mm/reach/test-v0"

FULL = os.strerror(errno.EFBIG)

Output = pytest.CaptureFixture[str]


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file of this process and its children grows beyond this size [bytes]."""
    process_context("marl_mm.workers")  # the server of later tests is not bound to it
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN  # as Python has it
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def refused(output: Output, *words: object) -> str:
    """The only line on stderr of a command that fails."""
    assert main([str(word) for word in words]) == 1
    (line,) = output.readouterr().err.splitlines()
    return str(line)


@pytest.fixture
def dataset(datasets_home: Path, episodes: list[Episode]) -> Path:
    provenance = Provenance(task="Reach-v0", collector="pd", seed=0, attempts=6)
    write_dataset(locate(ID), arrays_of(episodes, ID), provenance)
    return datasets_home / ID


def test_errors_name_the_file_that_is_written(tmp_path: Path) -> None:
    """Not the temporary one, nor none."""
    path = tmp_path / "values.json"
    with room_for(100), pytest.raises(OSError) as refusal:
        write_json(path, list(range(1000)))
    assert (refusal.value.errno, refusal.value.filename) == (errno.EFBIG, str(path))
    with pytest.raises(OSError) as refusal, new_file(path) as temporary:
        temporary.rmdir()
    assert refusal.value.filename == str(path)
    with pytest.raises(OSError, match=f"in words: '{path}'"), new_file(path):
        raise OSError("in words")
    with pytest.raises(OSError) as refusal, new_folder(path) as temporary:
        (temporary / "a" / "b").read_text()
    assert refusal.value.filename == str(path / "a" / "b")
    assert names(tmp_path) == []


def test_a_file_is_appended_to_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    append(path, b"first\n")
    append(path, b"second\n")
    with room_for(20), pytest.raises(OSError) as refusal:
        append(path, b"too long\n")
    assert refusal.value.filename == str(path)
    assert path.read_text() == "first\nsecond\n"
    with room_for(3), pytest.raises(OSError):
        append(tmp_path / "new", b"too long\n")
    assert names(tmp_path) == ["lines"]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.ENOSPC, "no room"), "no room: standard output"),
        (OSError(errno.ENOSPC, "no room", "here"), "no room: here"),
        (OSError(errno.ENOMEM, "no memory"), "no memory"),
        (OSError("in words"), "in words"),
    ],
)
def test_only_what_is_printed_is_blamed_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: Output, error: OSError, message: str
) -> None:
    def fail(words: list[str]) -> int:
        raise error

    monkeypatch.setattr(cli, "_run", fail)
    monkeypatch.setattr(os, "dup2", lambda *descriptors: None)
    assert main(["tasks"]) == 1
    assert capsys.readouterr().err == f"marl-mm: {message}\n"


@pytest.mark.slow
@pytest.mark.parametrize("form", ["torchscript", "onnx"])
def test_an_exported_policy_is_whole_or_not_there(
    tmp_path: Path, capsys: Output, form: str
) -> None:
    path = tmp_path / f"policy{'.ts' if form == 'torchscript' else '.onnx'}"
    words = "export", "pretrained", "--format", form, "--out", path
    with room_for(16_000):
        assert refused(capsys, *words) == f"marl-mm: {FULL}: {path}"
    assert names(tmp_path) == []


def test_a_policy_that_cannot_be_written_is_one_line(capsys: Output) -> None:
    assert main(["export", "pretrained", "--out", "/proc/x.ts"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "/proc/x.ts" in line


@pytest.mark.parametrize("room", [400, 8_000])  # the complaint has to fit, too
@pytest.mark.parametrize(
    "words",
    [
        ["export", ID, "--out"],
        ["mix", f"{ID}:15", "--out"],
        ["split", ID, "--out"],
        ["filter", ID, "--outcome", "reached", "--out"],
    ],
    ids=lambda words: words[0],
)
def test_a_dataset_is_whole_or_not_there(
    dataset: Path, tmp_path: Path, capfd: Output, words: list[str], room: int
) -> None:
    """HDF5 is told nothing of it: it would complain on stderr and crash."""
    folder = tmp_path / "out"
    folder.mkdir()
    with room_for(room):
        line = refused(capfd, "datasets", *words, folder / "new")
    assert line.startswith(f"marl-mm: {FULL}: {folder}/new")
    assert names(folder) == []


def test_no_room_for_temporary_files_is_not_blamed_on_the_data(
    dataset: Path, capsys: Output
) -> None:
    cache.clear()
    with room_for(1000):
        line = refused(capsys, "datasets", "show", ID)
    assert f"the folder of temporary files, {tempfile.gettempdir()}: {FULL}" in line
    assert str(dataset) not in line
    assert main(["datasets", "verify", ID]) == 0


def test_an_imported_dataset_is_whole_or_not_there(
    dataset: Path, tmp_path: Path, capfd: Output
) -> None:
    table, folder = tmp_path / "table.h5", tmp_path / "out"
    folder.mkdir()
    assert main(["datasets", "export", ID, "--out", str(table)]) == 0
    capfd.readouterr()
    with room_for(8_000):
        line = refused(capfd, "datasets", "import", table, "--out", folder / "new")
    assert line.startswith(f"marl-mm: {FULL}: {folder}/new")
    assert names(folder) == []


def test_files_by_way_of_memory_have_the_bytes_of_those_on_a_disk(
    tmp_path: Path,
) -> None:
    def fill(file: Any) -> None:
        for number in range(100):
            group = file.create_group(f"group_{number}", track_order=True)
            group.attrs["number"] = number
            for size in (3, 1_000, 40_000 * (number % 50 == 7)):
                values = np.arange(size) + number
                group.create_dataset(f"{size}", data=values, track_times=False)
            group.create_dataset(
                "packed",
                data=np.zeros(1_000),
                compression="gzip",
                shuffle=True,
                track_times=False,
            )

    for options in ({}, {"libver": ("v110", "v110")}):
        with h5py.File(tmp_path / "disk", "w", **options) as file:
            fill(file)
        hdf5_files.write_new(tmp_path / "memory", fill, **options)
        with room_for(100_000_000):
            hdf5_files.write_new(tmp_path / "limited", fill, **options)
        expected = (tmp_path / "disk").read_bytes()
        assert (tmp_path / "memory").read_bytes() == expected
        assert (tmp_path / "limited").read_bytes() == expected


def test_a_checkpoint_stays_as_it_was(
    tmp_path: Path, make_episode: Callable[..., Episode]
) -> None:
    arrays = arrays_of([make_episode(i, 4) for i in range(6)], "x")
    config = MabcConfig(updates=2, batch_size=8, hidden=(64, 64))
    algorithm = Mabc(config, arrays, make_task(), [0])
    path = tmp_path / "checkpoint.pt"
    save_seed(path, algorithm, 0)
    before = path.read_bytes()
    with room_for(20_000), pytest.raises(OSError) as refusal:
        save_seed(path, algorithm, 0)
    assert (refusal.value.errno, refusal.value.filename) == (errno.EFBIG, str(path))
    assert path.read_bytes() == before and names(tmp_path) == ["checkpoint.pt"]


@pytest.mark.parametrize("logger", [CsvLogger, TensorBoardLogger])
def test_a_logger_names_its_file_and_leaves_it_whole(
    tmp_path: Path, logger: Callable[..., Any], capfd: Output
) -> None:
    log = logger(tmp_path, "step", [])
    log.log(1, {"step": 1, "loss": 0.5})
    (path,) = tmp_path.iterdir()
    before = path.read_bytes()
    with room_for(len(before) + 2), pytest.raises(OSError) as refusal:
        log.log(2, {"step": 2, "loss": 0.25})
    assert (refusal.value.errno, refusal.value.filename) == (errno.EFBIG, str(path))
    assert path.read_bytes() == before
    log.close(failed=True)
    assert capfd.readouterr().err == ""  # no thread fails on its own


def test_a_record_names_its_file_and_leaves_it_whole(tmp_path: Path) -> None:
    path = tmp_path / METRICS
    with RunLog(tmp_path, "step", 0, loggers=()) as log:
        log.add({"step": 1, "loss": 0.5})
        before = path.read_bytes()
        with room_for(len(before) + 2), pytest.raises(OSError) as refusal:
            log.add({"step": 2, "loss": 0.25})
    assert refusal.value.filename == str(path) and path.read_bytes() == before


FRAMES = [*np.random.default_rng(0).integers(0, 255, (40, 64, 96, 3), np.uint8)]


@pytest.mark.parametrize("ending", [".mp4", ".gif"])
def test_a_film_is_whole_or_not_there(
    tmp_path: Path, ending: str, capfd: Output
) -> None:
    path = tmp_path / f"film{ending}"
    with room_for(20_000), pytest.raises(MarlMmError, match=f"cannot write {path}: "):
        write_video(path, FRAMES, 10)
    assert names(tmp_path) == [] and capfd.readouterr().err == ""
    write_video(path, FRAMES, 10)
    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] == len(FRAMES)


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (
            "cat > /dev/null; echo '[x] Error: Disk quota exceeded' >&2; exit 228",
            "Disk",
        ),
        ("exit 3", "ffmpeg ended with 3"),
        ("kill -KILL $$", "ffmpeg was ended: Killed"),
    ],
)
def test_why_a_film_could_not_be_made_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, reason: str
) -> None:
    """Also if ffmpeg ends before it has taken all frames."""
    program, path = tmp_path / "ffmpeg", tmp_path / "out" / "film.mp4"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(program))
    with pytest.raises(MarlMmError, match=f"cannot write {path}: {reason}"):
        write_video(path, FRAMES, 10)
    assert names(path.parent) == []


def test_an_odd_film_is_as_large_as_the_next_even_one(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    write_video(path, [frame[:63, :95] for frame in FRAMES], 10)
    about = next(imageio_ffmpeg.read_frames(str(path)))
    assert tuple(about["size"]) == (96, 64)


def test_a_figure_is_whole_or_not_there(tmp_path: Path) -> None:
    path = tmp_path / "strip.png"
    with room_for(1_000), pytest.raises(OSError) as refusal:
        film_strip(path, [("forward", [("step 0", FRAMES[0])])])
    assert refusal.value.filename == str(path) and names(tmp_path) == []


@pytest.mark.slow
def test_training_ends_with_one_line_and_goes_on_later(
    dataset: Path, tmp_path: Path, capsys: Output
) -> None:
    """There is room for the best policy, but not for a checkpoint."""
    words = ["train", "mabc", "--dataset", ID, "--out", str(tmp_path / "runs")]
    words += ["--updates", "2", "--hidden", "16", "--eval-episodes", "2"]
    words += ["--curve-every", "2", "--curve-episodes", "1", "--workers", "1"]
    words += ["--max-steps", "4"]
    with room_for(12_000):
        assert main(words) == 1
    lines = capsys.readouterr().err.splitlines()
    path = tmp_path / "runs" / "0" / "checkpoint.pt"
    assert lines[-1] == f"marl-mm: {FULL}: {path}"
    assert not any("Traceback" in line for line in lines)
    assert not path.exists()
    assert not [name for name in names(path.parent) if name.startswith(".")]
    assert main([*words, "--overwrite"]) == 0
