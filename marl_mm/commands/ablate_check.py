"""Whether committed tables and figures are what their rows give, to the byte."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib

from marl_mm.errors import FailedRunsError, MarlMmError, UsageError
from marl_mm.files import new_file

_FIGURES = (".png", ".svg")

_DRAWN_WITH = "drawn_with.txt"
"""In a folder of results: the version of Matplotlib that drew the figures there."""


@contextmanager
def every_failure(
    usage: bool = True,
) -> Iterator[Callable[[Callable[[], object]], None]]:
    """Gives what tries things whose failures are raised together, at the end.

    Args:
        usage: Whether what makes no sense waits until then, too.

    Raises:
        FailedRunsError: If any failed.
    """
    failures: list[str] = []

    def attempt(action: Callable[[], object]) -> None:
        try:
            action()
        except MarlMmError as error:
            if isinstance(error, UsageError) and not usage:
                raise
            failures.append(str(error))

    yield attempt
    if failures:
        raise FailedRunsError("; ".join(failures))


def note_artist(results: Path) -> None:
    """Write down what draws the figures in a folder."""
    with new_file(results / _DRAWN_WITH) as temporary:
        temporary.write_text(_artist())


def check_drawings(
    results: Path, files: Sequence[str], draw: Callable[[Path], object]
) -> None:
    """Print of every file whether it is what is drawn now.

    Args:
        results: Folder of the files.
        files: Their names.
        draw: Draws them into another folder, from the rows in ``results``.

    Raises:
        MarlMmError: If one is another. Figures may be that another Matplotlib drew.
    """
    known_artist = results / _DRAWN_WITH
    artist = known_artist.read_text() if known_artist.exists() else _artist()
    wrong = []
    with TemporaryDirectory() as folder:
        draw(Path(folder))
        for name in files:
            there, here = results / name, Path(folder, name)
            if not there.exists():
                told = "missing"
            elif there.read_bytes() == here.read_bytes():
                told = "the same"
            elif there.suffix in _FIGURES and artist != _artist():
                told = f"not compared, drawn with {artist.strip()}"
            else:
                told = "another"
            print(f"{there}: {told}")
            if told in ("missing", "another"):
                wrong.append(str(there))
    if wrong:
        raise MarlMmError(
            f"{', '.join(wrong)}: not what the rows there give; draw again with "
            "--overwrite"
        )


def _artist() -> str:
    return f"matplotlib {matplotlib.__version__}\n"
