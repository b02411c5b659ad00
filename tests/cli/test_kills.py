"""Whatever is killed at whatever moment goes on to the same bytes.

Two random moments for each kind of work; with MARL_MM_KILLS=100 as many of each:

    MARL_MM_KILLS=100 pytest tests/cli/test_kills.py -o faulthandler_timeout=0
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest

POINTS = int(os.environ.get("MARL_MM_KILLS", "2"))
"""Number of moments for each kind of work."""

KINDS = ("collect", "offline", "fine-tuned", "online", "study", "mix", "cache")


@pytest.fixture(scope="module")
def killer(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Popen[str]"]:
    """The process of which all work is a fork."""
    script, folder = Path(__file__).with_name("kills.py"), tmp_path_factory.mktemp("x")
    command = [sys.executable, str(script), str(folder), str(POINTS)]
    with Popen(command, stdin=PIPE, stdout=PIPE, text=True) as process:
        yield process
        process.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_killed_work_goes_on_to_the_same_bytes(kind: str, killer: "Popen[str]") -> None:
    assert killer.stdin is not None and killer.stdout is not None
    killer.stdin.write(f"{kind}\n")
    killer.stdin.flush()
    told: list[dict[str, Any]] = [{}]
    while "kind" not in told[-1]:
        line = killer.stdout.readline()
        assert line, "it has ended"
        told.append(json.loads(line))
    _, *differences, counts = told
    assert differences == [] and counts["same"] == POINTS, counts
    assert counts["killed"] > 0
