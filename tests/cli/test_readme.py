"""What the README tells people to type works."""

import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from marl_mm.cli import main
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.episode import Episode
from marl_mm.eval.ablations import ABLATIONS, BLOCKS
from marl_mm.eval.offline import ablation_table
from marl_mm.eval.online import SETTINGS
from marl_mm.eval.online_tables import online_table
from marl_mm.eval.readme import TABLES, filled
from marl_mm.eval.rows import read_rows, write_csv

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()

SMALL = {"steps": "60", "episodes": "2"}
"""The README's commands run for real, with these numbers in place of its own."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def shrunk(line: str) -> list[str]:
    for name, value in SMALL.items():
        line = re.sub(rf"--{name} \d+", f"--{name} {value}", line)
    words = line.replace('"', "").split()[1:]
    if words[0] == "train":
        words += ["--updates", "100", "--curve-episodes", "1", "--eval-episodes", "2"]
    if words[0] == "play":
        words += ["--max-steps", "2", "--fps", "2"]
    return words


@pytest.mark.slow
def test_commands_and_code_run_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, datasets_home: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    commands = [
        line
        for block in blocks("bash")
        for line in block.splitlines()
        if line.startswith("marl-mm")
    ]
    assert len(commands) == 6
    for line in commands:
        assert main(shrunk(line)) == 0, line
    quickstart = tmp_path / "runs" / "quickstart"
    quickstart.mkdir()
    (tmp_path / "runs/mabc/0").rename(quickstart / "mabc")
    (code,) = blocks("python")
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert len(names["action"]) == 4  # type: ignore[arg-type]


def test_rates_in_sentences_stand_in_the_committed_tables() -> None:
    """Each with its deviation, its interval, or both, as whole numbers of one cell."""
    number = r"(?<![\d.])(\d+\.\d+)"
    text = " ".join(line for line in README.splitlines() if not line.startswith("|"))
    told = re.findall(rf"{number} \+- {number}", text)
    intervals = re.findall(rf"{number}(?: \+- [\d.]+)? % \[{number}, {number}\]", text)
    results = ROOT / "eval/results"
    tables = [
        ablation_table(one, read_rows(results / f"offline/{name}.csv"))
        for name, one in ABLATIONS.items()
    ]
    tables.append(online_table(read_rows(results / "online/online.csv"), SETTINGS))
    cells = re.findall(
        rf"{number} \+- {number}(?: \[{number}, {number}\])?", "\n".join(tables)
    )
    assert len(told) >= 5 and len(intervals) >= 8
    assert set(told) <= {(mean, deviation) for mean, deviation, *_ in cells}
    assert set(intervals) <= {(mean, low, high) for mean, _, low, high in cells}


@pytest.mark.slow
def test_the_ablation_of_ones_own_runs_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("py")
    Path("widths.py").write_text(code)
    small = ["--budget", "smoke", "--seeds", "0", "--workers", "1"]
    assert "marl-mm ablate widths.py:WIDTHS" in " ".join(README.split())
    assert main(["ablate", "widths.py:WIDTHS", *small]) == 0
    assert Path("runs/offline-smoke/results/widths.png").exists()


def test_commands_about_datasets_run_as_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    datasets_home: Path,
    make_episode: Callable[..., Episode],
) -> None:
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(("good", "medium", "random")):
        location = locate(f"marl_mm/reach/{name}-v0")
        first = 20 * number
        episodes = [make_episode(i, steps=10) for i in range(first, first + 10)]
        for episode in episodes:
            episode.states[:, 6] = 0.5
        provenance = Provenance(
            task="Reach-v0", overrides={"max_steps": 25}, collector=name
        )
        write_dataset(location, arrays_of(episodes, location.id), provenance)
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    assert len(lines) == 9
    for line in lines[3:]:  # the first three collect what stands there already
        small = re.sub(r":(\d+)000\b", r":\1", line).replace(" --replay", "")
        assert main(small.partition("#")[0].split()[1:]) == 0, line


def test_the_map_of_folders_is_true() -> None:
    listed = re.findall(r"^    (?:  )?(\S+)  +\S", README, flags=re.MULTILINE)
    for name in listed:
        candidates = (ROOT / name, ROOT / "marl_mm" / name)
        assert any(path.exists() for path in candidates), name
    for link in re.findall(r"\]\(([\w/.]+)\)", README):
        assert (ROOT / link).exists(), link


def test_the_tables_are_made_of_the_committed_results() -> None:
    """If this fails: python -m marl_mm.eval.readme."""
    for name in TABLES:
        assert f"<!-- {name} -->" in README
    assert filled(README) == README


def test_a_table_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    rows = [{"name": "a", "goals": 3, "share": 0.25, "interval": [0.1, 0.5]}]
    write_csv(tmp_path / "rows.csv", rows)
    assert read_rows(tmp_path / "rows.csv") == rows


def test_the_script_does_what_others_are_to_learn_from_it() -> None:
    """On every task with a block, and on as many goals as these are evaluated on."""
    for task in BLOCKS.values():
        packed = (ROOT / f"eval/results/script/{task}.json.gz").read_bytes()
        (found,) = json.loads(gzip.decompress(packed))
        assert found["task"] == task and found["overrides"] == {}
        assert len({row["index"] for row in found["episodes"]}) == 200
        assert sum(row["success"] for row in found["episodes"]) >= 190


def test_imitation_of_the_script_does_what_was_asked_of_it() -> None:
    """From 20,000 steps, with three seeds; tests hold the table to its rows."""
    asked = {"CarryReach-v0": 0.9, "GraspReach-v0": 0.8}
    summary = read_rows(ROOT / "eval/results/offline/blocks.csv")
    for dataset, task in BLOCKS.items():
        (row,) = (
            row
            for row in summary
            if (row["dataset"], row["setting"]) == (dataset, "mabc")
        )
        assert (row["seeds"], row["goals"]) == (3, 200)
        assert row["success"] >= asked.get(task, 0.9)
