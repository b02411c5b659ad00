"""What README and pages say is true, and what they tell people to type works."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.envs.registry import TASKS, kind_of
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.table import Table
from marl_mm.eval.studies.targets import STUDIES

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
RUN = [
    page for page in PAGES if re.search(r"^```(python|bash)", page.read_text(), re.M)
]

NUMBER = re.compile(r"(?<![\d.])\d+\.\d+(?![\d.])")
"""Number with a decimal."""

OFFLINE = {"OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}


@pytest.mark.slow
def test_generated_pages_and_tables_are_up_to_date(datasets_home: Path) -> None:
    """If this fails: python tools/pages.py."""
    made = subprocess.run(
        [sys.executable, "tools/pages.py", "--check"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert (made.returncode, made.stdout) == (0, ""), made.stderr


@pytest.fixture(scope="module")
def runner() -> Iterator["subprocess.Popen[str]"]:
    """Runs pages in processes of their own."""
    script = Path(__file__).with_name("run_blocks.py")
    with subprocess.Popen(
        [sys.executable, str(script)],
        env=os.environ | OFFLINE,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process
        process.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_blocks_run_as_written(
    page: Path, tmp_path: Path, runner: "subprocess.Popen[str]"
) -> None:
    assert runner.stdin is not None and runner.stdout is not None
    runner.stdin.write(f"{page}\t{tmp_path}\n")
    runner.stdin.flush()
    status = runner.stdout.readline()
    assert status == "0\n", (tmp_path / "said.txt").read_text()[-4000:]


def test_links_lead_to_files() -> None:
    for page in PAGES:
        text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
        for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_how_tos_are_short_and_the_readme_too() -> None:
    for page in (ROOT / "docs/howto").glob("*.md"):
        assert len(page.read_text().splitlines()) <= 60, page
    assert len(README.read_text().splitlines()) <= 200


def test_the_readme_names_every_task_and_algorithm() -> None:
    """Of a kind of task in several levels the medium one."""
    tasks = [name for name in TASKS.names() if kind_of(name) == name]
    for name in (*tasks, *ALGORITHMS.names()):
        assert f"`{name}`" in README.read_text(), name


def test_the_map_of_folders_is_true() -> None:
    text = README.read_text()
    listed = re.findall(r"^    (?:  )?([\w.]+/)[ ,]", text, flags=re.MULTILINE)
    for name in listed:
        candidates = (ROOT / name, ROOT / "marl_mm" / name)
        assert any(path.exists() for path in candidates), name
    assert len(listed) >= 10


def test_rates_in_sentences_stand_in_the_committed_tables() -> None:
    """Each with its deviation, its interval, or both, as whole numbers of one cell."""
    number = r"(?<![\d.])(\d+\.\d+)"
    text = " ".join(
        line
        for page in (README, *(ROOT / "docs/results").glob("*.md"))
        for line in page.read_text().splitlines()
        if not line.startswith("|")
    )
    deviations = re.findall(rf"{number} \+- {number}", text)
    intervals = re.findall(rf"{number}(?: \+- [\d.]+)? % \[{number}, {number}\]", text)
    results = ROOT / "eval/results"
    tables = [
        Table(study, read_rows(results / f"studies/{name}.csv")).markdown()
        for name, study in STUDIES.items()
        if (results / f"studies/{name}.csv").exists()
    ]
    cells = re.findall(
        rf"{number} \+- {number}(?: \[{number}, {number}\])?", "\n".join(tables)
    )
    assert len(deviations) >= 5 and len(intervals) >= 8
    assert set(deviations) <= {(mean, deviation) for mean, deviation, *_ in cells}
    assert set(intervals) <= {(mean, low, high) for mean, _, low, high in cells}


def test_numbers_of_the_benchmarks_sentences_stand_in_its_tables() -> None:
    """Those with a decimal, in a column of a dataset or algorithm that the sentence
    names, and, where it names algorithms by their ids, in a row of one."""
    text = (ROOT / "docs/results/benchmark.md").read_text()
    cells: dict[tuple[str, str], set[str]] = {}
    for table in re.findall(r"(?:^\| .*\n)+", text, re.M):
        lines = [
            [c.strip("`* ") for c in line.split("|")] for line in table.split("\n")
        ]
        heads, _, *rows = lines
        heads = [re.sub("/(.*)-v0", r"-\1", head) for head in heads]
        for row in rows:
            for head, value in zip(heads[2:], row[2:], strict=False):
                cells.setdefault((row[1], head), set()).update(NUMBER.findall(value))
    listed = re.findall(r"^(?:- |\d+\. )(.*(?:\n {2,}.*)*)", text, re.M)
    every, found = {row for row, _ in cells}, 0
    for sentence in listed:
        names = {*re.findall("`([^`]+)`", sentence)}
        places = {(a, b) for a in names & every or every for b in names}
        numbers = NUMBER.findall(sentence)
        allowed = {n for place in places & cells.keys() for n in cells[place]}
        assert {*numbers} <= allowed, sentence
        found += len(numbers)
    assert len(listed) >= 19 and found >= 60
