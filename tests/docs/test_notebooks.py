"""Notebooks run from their first cell to their last, with small numbers."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path) -> None:
    """If it is to show something else: python tools/notebooks.py."""
    ran = subprocess.run(
        [sys.executable, "tools/notebooks.py", "--check", path.stem],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]


def test_notebooks_are_small() -> None:
    """Outputs are kept with them, as the site shows them, but lean."""
    assert len(NOTEBOOKS) == 3
    assert sum(path.stat().st_size for path in NOTEBOOKS) < 400_000
