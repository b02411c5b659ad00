"""Reading of HDF5 files in a process of its own.

The HDF5 library can crash, never end, or ask for all memory at a file that was made to
that end. The process that reads has limits, and hands over plain arrays.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays, save_arrays
from marl_mm.datasets.hdf5 import read_hdf5
from marl_mm.datasets.hdf5_files import reading_limits
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout
from marl_mm.processes import importing_this, limit_memory, limit_processor_time

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

_LONGEST = 10_000
"""Largest length of an error [bytes], which a pipe holds while nobody reads."""

_CODE = "from marl_mm.datasets.convert import main; main()"


def read_apart(
    path: Path, total: int, layout: Layout, info: Sequence[str]
) -> EpisodeArrays:
    """``read_hdf5`` of a file that may have been made to do harm.

    Args:
        path: The file.
        total: Number of episodes in the file.
        layout: Layout of the states and actions.
        info: Names of the step numbers.

    Raises:
        DatasetError: If the file is damaged, or reading it takes too long.
    """
    with TemporaryDirectory(prefix="marl_mm-") as folder:
        out = Path(folder, "arrays.npz")
        asked = {
            "path": str(path.absolute()),
            "total": total,
            "layout": layout.to_json(),
            "info": [*info],
            "out": str(out),
        }
        # Anything may print to the usual files, such as a plug-in.
        complaints, end = os.pipe()
        os.set_blocking(complaints, False)
        try:
            ended = subprocess.run(
                [sys.executable, "-c", _CODE],
                input=json.dumps({**asked, "complaints": end}),
                capture_output=True,
                env={**os.environ, **importing_this(), **_ONE_THREAD},
                pass_fds=(end,),
                text=True,
                check=False,
            )
            with suppress(BlockingIOError):  # there is none
                complaint = os.read(complaints, _LONGEST)
                raise DatasetError(complaint.decode(errors="surrogateescape"))
        finally:
            os.close(complaints)
            os.close(end)
        if ended.returncode == -signal.SIGXCPU:
            seconds, _ = reading_limits(path.stat().st_size)
            raise DatasetError(
                f"{path} is damaged: reading it takes over {seconds} s of the processor"
            )
        if ended.returncode or not out.exists():
            why = f"it ended with {ended.returncode}"
            raise DatasetError(
                f"{path} is damaged: the HDF5 library cannot read it ({why})"
            )
        return load_arrays(out, layout)


def _hand_over(out: Path, arrays: EpisodeArrays) -> None:
    """Write arrays into a temporary file.

    Raises:
        DatasetError: If there is no room for it.
    """
    try:
        save_arrays(out, arrays, compress=False)
    except OSError as error:
        raise DatasetError(
            f"cannot write {arrays.nbytes:,} bytes into the folder of temporary files, "
            f"{out.parents[1]}: {error.strerror or error}; make room there, or name "
            "another folder in $TMPDIR"
        ) from error


def main() -> None:
    """Read what standard input asks for; errors go to a pipe that it names."""
    asked = json.load(sys.stdin)
    path, out = Path(asked["path"]), Path(asked["out"])
    seconds, memory = reading_limits(path.stat().st_size)
    limit_memory(memory)
    limit_processor_time(seconds)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    layout = Layout.from_json(asked["layout"])
    try:
        arrays = read_hdf5(path, asked["total"], layout, asked["info"])
        _hand_over(out, arrays)
        return
    except DatasetError as error:
        complaint = str(error)
    except (OSError, MemoryError) as error:
        reason = str(error) or "it needs more memory than its size allows"
        complaint = f"cannot read {path}: {reason}"
    text = complaint.encode(errors="surrogateescape")
    os.write(asked["complaints"], text[:_LONGEST])
