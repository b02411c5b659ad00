"""Whether committed tables are what their rows give, to the byte."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from marl_mm.errors import FailedRunsError, MarlMmError, UsageError


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


def check_tables(
    results: Path, files: Sequence[str], draw: Callable[[Path], object]
) -> None:
    """Print of every table whether it is what its rows give now.

    Figures are drawn again at will, and not compared.

    Args:
        results: Folder of the files.
        files: Their names.
        draw: Draws them into another folder, from the rows in ``results``.

    Raises:
        MarlMmError: If one is another.
    """
    wrong = []
    with TemporaryDirectory() as folder:
        draw(Path(folder))
        for name in files:
            there, here = results / name, Path(folder, name)
            state = "missing"
            if there.exists():
                same = there.read_bytes() == here.read_bytes()
                state = "the same" if same else "another"
            print(f"{there}: {state}")
            if state != "the same":
                wrong.append(str(there))
    if wrong:
        raise MarlMmError(
            f"{', '.join(wrong)}: not what the rows there give; draw again with "
            "--overwrite"
        )
