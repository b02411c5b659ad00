"""Whatever is killed at whatever moment goes on to the same bytes.

Two random moments for each kind of work; with MARL_MM_KILLS=100 as many of each:

    MARL_MM_KILLS=100 pytest tests/cli/test_kills.py -o faulthandler_timeout=0
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

POINTS = int(os.environ.get("MARL_MM_KILLS", "2"))
"""Number of moments for each kind of work."""

KINDS = ("collect", "offline", "fine-tuned", "online", "study", "mix", "cache")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_killed_work_goes_on_to_the_same_bytes(kind: str, tmp_path: Path) -> None:
    script = Path(__file__).with_name("kills.py")
    ended = subprocess.run(
        [sys.executable, str(script), kind, str(POINTS), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    *differences, counts = map(json.loads, ended.stdout.splitlines())
    assert differences == [] and counts["same"] == POINTS, counts
    assert counts["killed"] > 0
