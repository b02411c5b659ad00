"""Targets of ``marl-mm ablate``: our studies by name, and studies of user files."""

import runpy
import sys
from pathlib import Path

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.studies import offline, online, paper
from marl_mm.eval.studies.study import Study

STUDIES = paper.STUDIES | offline.STUDIES | online.STUDIES
"""Studies by name."""

GROUPS = {
    "paper": ("table4", "table5", "fig4", "fig5", "fig7", "fig8", "fig9", "fig10"),
    "all": (*STUDIES, "alpha"),
}
"""Targets by the name of their group; ``alpha`` is the worth of the learnt alpha."""


def study_of(path: Path, name: str) -> Study:
    """A study of a user's Python file.

    Raises:
        UsageError: If the file has no study of that name.
    """
    if not path.is_file():
        raise UsageError(f"there is no file {path}, expected FILE.py:NAME")
    sys.path.insert(0, str(path.parent))  # of what it imports itself
    try:
        variables = runpy.run_path(str(path))
    except MarlMmError as error:
        raise UsageError(f"{path}: {error}") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} cannot be run: {reason:.300}") from error
    finally:
        sys.path.remove(str(path.parent))
    study = variables.get(name)
    if isinstance(study, Study):
        return study
    names = [key for key, value in variables.items() if isinstance(value, Study)]
    raise UsageError(
        f"{path} has no Study called {name!r}, expected one of "
        f"{', '.join(names) or 'its names: it has none'}"
    )
