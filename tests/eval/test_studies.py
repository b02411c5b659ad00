"""Studies: declared, run, interrupted, drawn and checked."""

import glob
import gzip
import json
import lzma
import os
import random
import re
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import marl_mm
from marl_mm.algorithms.registry import TUNED, preset
from marl_mm.algorithms.runlog import METRICS
from marl_mm.cli import main
from marl_mm.config_diff import as_json
from marl_mm.datasets.dataset import load_dataset
from marl_mm.declared import as_record
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.errors import (
    MarlMmError,
    OtherConfigError,
    OutputExistsError,
    UnknownDatasetError,
    UsageError,
)
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies import Curves, learners
from marl_mm.eval.studies import jobs as studies_jobs
from marl_mm.eval.studies import rows as study_rows
from marl_mm.eval.studies.cells import write_cells
from marl_mm.eval.studies.jobs import Job, _begin, _by_process, _do, do_jobs
from marl_mm.eval.studies.learners import Learner, training_of
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.paper import PAPER, reported
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.settings import BEST, LAST, Online, Probe, Setting
from marl_mm.eval.studies.shown import Reported
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.eval.studies.targets import (
    COMPARISONS,
    GROUPS,
    STUDIES,
    Comparison,
    study_of,
)
from marl_mm.files import write_json
from marl_mm.progress import Advance, Bar, silent_bar
from marl_mm.runs.making import Datasets
from marl_mm.runs.paper import GOOD_30K
from marl_mm.runs.sources import Mix, Source
from marl_mm.runs.training import Offline
from marl_mm.runs.training import training_of as default_training
from marl_mm.sim.config import Engine, default_engine
from marl_mm.versions import versions
from tests.forks import Fork

WorkersOf = Callable[[int], list[psutil.Process]]

OWN = """
from marl_mm.eval.studies import BEST, LAST, Probe, Setting, Source, Study

settings = [
    Setting(f"width-{n}", f"{n} units", changes={"hidden": (n, n)}) for n in (16, 32)
]
HELD = Probe("held", "alpha held at one half", alpha=0.5)
NARROW = Probe(
    "narrow", "elsewhere", overrides={"goal_y": (-0.1, 0.1)}, task="PreciseReach-v0"
)
PROBES = LAST, BEST, HELD, NARROW
SIXTY = Source(steps=60, name="sixty", engine="mujoco")  # the faster engine
CELLS = [(SIXTY, setting) for setting in settings]
WIDTHS = Study("TD3+BC by width.", CELLS, PROBES, True)
FAILS = Study(
    "One of two.",
    [
        (SIXTY, Setting("huge", "huge", changes={"batch_size": 4321})),
        (SIXTY, settings[0]),
    ],
)
WILD = Setting("wild", "wild", changes={"critic_learning_rate": 1e38})
DIVERGES = Study("What diverges counts as it is.", [(SIXTY, WILD)])
ELSEWHERE = Study("Of data that nobody has.", [("none", settings[0])])
FEW = {"updates": 100, "hidden": (16, 16)}
TINY = Study(
    "Of data that is collected first.",
    [
        (
            Source(steps=60, name="tiny", engine="mujoco"),
            Setting("few", "few", changes=FEW, goals=2, curve_goals=2),
        )
    ],
)
"""
"""Studies of one's own, of a dataset that is collected first."""

RESULTS = Path(__file__).resolve().parents[2] / "eval/results/studies"

OURS = Setting("ours", "ours")
ONE = Study("x", [("good-5k", OURS)])
HER = Setting("her", "her", "ddpg-her")

FILES = ["widths.csv", "widths.png"]


@pytest.fixture
def own(tmp_path: Path, datasets_home: Path) -> Path:
    path = tmp_path / "own.py"
    path.write_text(OWN)
    return path


def words(own: Path, runs: Path, *more: str) -> list[str]:
    small = ["--budget", "smoke", "--seeds", "0", "1", "--workers", "1"]
    return ["ablate", f"{own}:WIDTHS", "--runs", str(runs), *small, *more]


def contents(results: Path) -> dict[str, bytes]:
    """Every table, figure and row, but for what tells the time."""
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Results of a study of which nothing was interrupted, of data of its own."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "own.py").write_text(OWN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder / "datasets"))
        assert main(words(folder / "own.py", folder / "runs")) == 0
    return contents(folder / "runs/results")


# --- Declarations ------------------------------------------------------------


def test_every_declaration_can_be_run() -> None:
    names: dict[str, Setting] = {}
    for study in STUDIES.values():
        assert study.cells
        for _, setting in study.cells:
            assert setting.config is not None  # made without complaint
            assert names.setdefault(setting.name, setting) == setting


def test_nothing_is_run_twice_under_two_names() -> None:
    cells = {cell_name(cell): cell for one in STUDIES.values() for cell in one.cells}
    ways = [
        (source, replace(setting, name="s", about="", changes={}), setting.config)
        for source, setting in cells.values()
    ]
    assert [way for way in ways if ways.count(way) > 1] == []


def test_the_papers_runs_have_its_budget() -> None:
    for name in ("table4", "table5", "fig7", "fig8", "fig9", "fig10"):
        study = STUDIES[name]
        presets = [setting.preset for _, setting in study.cells]
        assert set(presets) == {"paper", "tuned"}  # side by side
        for _, setting in study.cells:
            assert setting.config.updates == 180_000


def test_the_papers_figures_stand_beside_its_own_settings_only() -> None:
    cells = [cell for one in STUDIES.values() for cell in one.cells]
    assert {reported(cell) for cell in cells} == {None, *PAPER.values()}
    c_is_1 = Setting("c1", "c = 1", changes={"q_weight": 1.0})
    assert reported((GOOD_30K, c_is_1)) is None
    same = reported((GOOD_30K, Setting("same", "same")))
    assert same == Reported("Table 4", 34.00, 32.19, updates=180_000)
    assert str(same) == "34.00 +- 32.19 (Table 4)"


@pytest.mark.slow
def test_what_is_committed_was_made_as_declared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise runs would be missing, or the datasets that they need."""
    words = ["ablate", "all", "--out", str(RESULTS), "--runs", str(tmp_path), "--plan"]
    assert main(words) == 0
    text = capsys.readouterr()
    assert "| all |  | 0 of 0 |" in text.out and "counted as" not in text.err


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Setting("0.5", "x"), "name is '0.5', expected a letter"),
        (lambda: Setting(3, "x"), "name is 3, expected a letter"),  # type: ignore[arg-type]
        (lambda: Setting("x", "x", changes=3), "changes is 3, expected values"),  # type: ignore[arg-type]
        (lambda: Online(demonstrations=3), "demonstrations is 3, expected a data"),  # type: ignore[arg-type]
        (lambda: ONE.run(name=".."), "name is '..', expected a letter"),
        (lambda: ONE.run(out=3), "`out` is 3, expected"),  # type: ignore[arg-type]
        (lambda: Setting("x", "x", "td3bc"), "td3bc"),
        (lambda: Setting("x", "x", preset="tunde"), "tunde"),
        (lambda: Setting("x", "x", goals=1), "goals is 1, expected 2, 4"),
        (lambda: Setting("x", "x", changes={"hidden": 64}), "'x'.* hidden is 64"),
        (lambda: Setting("x", "x", changes={"updates": 1.5}), "updates is 1.5"),
        (lambda: Setting("x", "x", changes={"layer_norm": "no"}), "is 'no'"),
        (lambda: Setting("x", "x", changes={"batch_size": 0}), "'x': batch_size is 0"),
        (lambda: Probe("x", "x", checkpoint="bset"), "'bset', expected one of last"),  # type: ignore[arg-type]
        (lambda: Probe("x", "x", task="Fly-v0"), "Fly-v0"),
        (lambda: Probe("x", "x", alpha=2.0), "alpha is 2.0, expected a number in"),
        (lambda: Probe("x", "x", overrides={"goal_w": 1}), "unknown field 'goal_w'"),
        (lambda: Setting("x", "x", goals="200"), "goals is '200', expected int"),  # type: ignore[arg-type]
        (lambda: Setting("x", "x", curve_goals=0), "curve_goals is 0, expected >= 1"),
        (lambda: Setting("x", "x", measured=("steps",)), "expected 'return' in it"),
        (lambda: Setting("x", "x", library="SB3"), "library is 'SB3', expected one of"),  # type: ignore[arg-type]
        (lambda: Setting("x", "x", library="sb3"), "whose algorithm is ddpg-her"),
        (lambda: Probe("x", "x", alpha="x"), "alpha is 'x', expected a finite"),  # type: ignore[arg-type]
        (lambda: Curves(panels="foo"), "panels is 'foo', expected preset or"),  # type: ignore[arg-type]
        (lambda: Study("x", [("good-5k", OURS)], ["last"]), "'last' is no Probe"),  # type: ignore[list-item]
        (
            lambda: Study("x", [("good-5k", OURS)], figure="return"),  # type: ignore[arg-type]
            "figure is 'return', expected True",
        ),
        (
            lambda: Study("x", [("good-5k", OURS)], figure=Curves("sucess_all")),
            "value is 'sucess_all', expected one of success_all",
        ),
        (
            lambda: Study("x", [("good-5k", OURS)], figure=Curves("train_return")),
            "value is 'train_return', expected one of success_all",
        ),
        (
            lambda: Study("x", [("good-5k", OURS)], seeds=(0, 1)),  # type: ignore[arg-type]
            "seeds is .0, 1., expected int",
        ),
        (lambda: Study("x", []), "has no cells"),
        (lambda: Study("x", [("good-5k", OURS)], probes=()), "has no probes"),
        (
            lambda: Study("x", [("good-5k", OURS)], table="foo"),  # type: ignore[arg-type]
            "table is 'foo', expected probes or episodes",
        ),
        (
            lambda: Study("x", [("good-5k", OURS)], (LAST, BEST), table="episodes"),
            "expected cells that learn online",
        ),
        (lambda: Mix("x", []), "mix 'x' has no parts"),
        (lambda: Mix("x", [("good-5k", 9)]), "expected pairs of a Source and"),  # type: ignore[list-item]
        (lambda: Mix("x", [Source()]), "expected pairs of a Source and"),  # type: ignore[list-item]
        (lambda: Mix("x", [(Source(), 0)]), "`steps` is 0"),
        (lambda: Source(settings=3), "settings is 3, expected values"),  # type: ignore[arg-type]
        (lambda: Source(first="x"), "first is 'x', expected a Source"),  # type: ignore[arg-type]
        (lambda: Study("x", ["good-5k"]), "expected pairs of a source"),  # type: ignore[list-item]
        (lambda: Study("x", [("a", OURS), ("a", OURS)]), "twice"),
        (lambda: Study("x", [("a", OURS)], (LAST, LAST)), "twice"),
        (lambda: Study("x", [(Online(), OURS)]), "td3-bc learns from a dataset"),
        (lambda: Study("x", [("a", HER)]), "ddpg-her learns from episodes of its own"),
        (lambda: Source(settings={"alpha_rul": 1}), "has no setting 'alpha_rul'"),
        (lambda: Source("pdd"), "pdd"),
        (lambda: Source(task="Fly-v0"), "Fly-v0"),
        (lambda: Source(steps=0), "`steps` is 0"),
        (lambda: Source(seed=-1), "the seed is -1"),
        (lambda: Mix("x", [(Source(), 10)], seed=-1), "the seed is -1"),
        (
            lambda: Mix("x", [(Source(), 10), (Source(engine="mujoco"), 10)]),
            "with engine None and mujoco, expected one in a mix",
        ),
    ],
)
def test_a_declaration_that_makes_no_sense_is_refused(
    make: Callable[[], object], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        make()


def test_declarations_that_differ_have_names_that_differ() -> None:
    names = {Source(settings={"kd": kd}).name for kd in (1.0, -1.0)}
    assert names == {"pd-reach-10000-0-kd-1-0", "pd-reach-10000-0-kd-minus-1-0"}


def test_a_dataset_of_other_steps_or_parts_is_another(datasets_home: Path) -> None:
    engine: Engine = "mujoco"
    few: dict[str, Any] = {"steps": 20, "max_steps": 3, "engine": engine}
    for name, seed in (("one", 0), ("two", 1)):
        marl_mm.collect("random", dataset=f"marl_mm/reach/{name}-v0", seed=seed, **few)
    short = Source("random", steps=20, name="one", engine=engine)
    with pytest.raises(UnknownDatasetError):
        Datasets().find(short)  # which has the task's 25 steps an episode
    made = Datasets()
    three, four = (replace(short, name=name, seed=3) for name in ("three", "four"))
    made.make(four)
    made.make(Mix("both", [(three, 10)]))
    assert made.find(Mix("both", [(three, 10)]))
    for other in (four, replace(three, collector="pd")):
        with pytest.raises(UnknownDatasetError):  # of another part, or another's
            made.find(Mix("both", [(other, 10)]))
    shutil.rmtree(load_dataset("three").location.folder)
    assert made.find(Mix("both", [(three, 10)])), (
        "its source is gone, which is no matter"
    )
    changed = Mix("both", [(replace(three, collector="pd"), 10)])
    origins = made.make(changed).provenance.origins.values()
    assert {origin.collector for origin in origins} == {"pd"}


def test_a_mix_of_other_data_of_ones_own_is_not_replaced(datasets_home: Path) -> None:
    few = Source("random", steps=30, name="few", engine=default_engine())
    marl_mm.mix_datasets({"good-5k": 10}, "both")
    before = load_dataset("both").fingerprint
    with pytest.raises(OutputExistsError, match="both"):
        Datasets().make(Mix("both", [(few, 20)]))
    assert load_dataset("both").fingerprint == before


def test_a_dataset_of_a_task_that_has_changed_is_another(
    datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Source("random", steps=20, name="few")
    Datasets().make(source)
    changed = make_task("Reach-v0", {"success_distance": 0.2})
    monkeypatch.setitem(TASKS._things, "Reach-v0", changed)
    with pytest.raises(OtherConfigError, match=r"success_distance = 0.05 \(now 0.2\)"):
        Datasets().make(source)


# --- Rows --------------------------------------------------------------------


def test_rows_of_another_plugin_or_engine_are_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learners, "record", lambda origin: {"own.py": "then"})
    store, cell = RowStore(tmp_path), ("good-5k", OURS)
    training = training_of(*cell, None, small=True)
    asked = [0], [LAST], learners.made_of(OURS, training), training.config
    record = {**asked[2], "probes": {}, "engine": "mujoco", "packages": versions()}
    write_json(tmp_path / "good-5k" / f"{OURS.name}.json", record)
    assert store.missing(cell, *asked) == [0]
    older = {**record, "packages": dict.fromkeys(versions(), "3.0.0")}
    write_json(tmp_path / "good-5k" / f"{OURS.name}.json", older)
    with pytest.raises(OtherConfigError, match=r"with mujoco 3.0.0 \(now mujoco"):
        store.missing(cell, *asked)
    monkeypatch.setattr(learners, "record", lambda origin: {"own.py": "now"})
    with pytest.raises(OtherConfigError, match=r"own.py = then \(now now\)"):
        store.missing(cell, [0], [LAST], learners.made_of(OURS, training), *asked[3:])


def finished(folder: Path, seed: int, q_policy: float = 1.0, **more: float) -> Path:
    """A run's folder with what rows are taken from: two goals, one point of a curve."""
    run = folder / f"{seed}-{q_policy}"
    run.mkdir()
    made_of = {"seed": seed, "preset": "tuned", "device": "cpu", "updates": 10}
    made_of["dataset"] = {"path": "elsewhere", "data_sha256": "0"}
    (run / "config.json").write_text(json.dumps(made_of))
    point = {"step": 10, "success/all": 0.5, "return/all": 1.0, "q/policy": q_policy}
    point |= more
    (run / METRICS).write_text(json.dumps(point) + "\n")
    measured = ("steps", "return", "final_distance", "d_mm", "d_mp", "alpha")
    episodes = [
        {"index": goal, "direction": "forward", "success": True}
        | dict.fromkeys(measured, 1.0)
        for goal in range(2)
    ]
    for probe in (LAST, BEST):
        found = {"episodes": episodes, "overrides": {}, "probe": probe.way}
        probe.file(run).write_text(json.dumps(found))
    return run


@pytest.mark.parametrize("writes", [0, 1, 2])
def test_rows_that_were_cut_off_between_files_are_made_again(
    writes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a cell that had another seed's already."""
    store, cell, made_of = (
        RowStore(tmp_path / "rows"),
        ("good-5k", OURS),
        dict[str, Any](),
    )
    store.keep(cell, {0: finished(tmp_path, 0)}, [LAST])
    left = writes

    def counted(write: Callable[..., None]) -> Callable[..., None]:
        def unless_cut_off(*given: Any) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                raise KeyboardInterrupt
            write(*given)

        return unless_cut_off

    for name in ("write_json", "write_csv"):
        write = getattr(study_rows, name)
        monkeypatch.setattr(study_rows, name, counted(write))
    runs = {1: finished(tmp_path, 1)}
    with pytest.raises(KeyboardInterrupt):
        store.keep(cell, runs, [LAST])
    monkeypatch.undo()
    settings = preset("mabc", TUNED)
    assert store.missing(cell, [0, 1], [LAST], made_of, settings) == [1]
    store.keep(cell, runs, [LAST])
    assert store.missing(cell, [0, 1], [LAST], made_of, settings) == []
    assert len(store.evaluations(cell, [0, 1], [LAST])) == 4
    assert len(store.curves(cell, [0, 1])) == 2


@pytest.mark.parametrize(("before", "now"), [(0.0, 0.3), (0.3, 0.0)])
def test_rows_of_another_setting_are_refused_though_defaults_are_not_recorded(
    before: float, now: float, tmp_path: Path
) -> None:
    store, cell = RowStore(tmp_path), ("good-5k", OURS)
    kept, asked = (
        replace(preset("cql", TUNED), bound_penalty=b) for b in (before, now)
    )
    record = {"algorithm": "cql", "probes": {"last": LAST.way}}
    path = tmp_path / "good-5k" / f"{OURS.name}.json"
    path.parent.mkdir()
    write_json(path, record | as_record(kept))
    missed = store.missing(cell, [0], [LAST], record | as_record(kept), kept)
    assert missed == [0]
    with pytest.raises(
        OtherConfigError, match=rf"bound_penalty = {before} \(now {now}"
    ):
        store.missing(cell, [0], [LAST], record | as_record(asked), asked)


PD = Source("pd", steps=60, name="mine")
NONE: dict[str, Any] = {}


@pytest.mark.parametrize(
    ("kept", "asked", "told"),
    [
        (
            {"probes": {"last": LAST.way | {"overrides": {"max_steps": 1}}}},
            (PD, NONE),
            r"probes\.last = .*'max_steps': 1",
        ),
        (
            {"probes": {"last": LAST.way | {"task": "PreciseReach-v0"}}},
            (PD, NONE),
            r"probes\.last\.task = PreciseReach-v0 \(now None\)",
        ),
        (NONE, (replace(PD, steps=90), NONE), r"source\.steps = 60 \(now 90\)"),
        (NONE, (replace(PD, settings={"kp": 8.0}), NONE), r"source\.settings\.kp = "),
        ({"online_steps": 4}, (PD, NONE), r"online_steps = 4 \(now 0\)"),
        ({"max_steps": 2}, (PD, NONE), r"max_steps = 2 \(now None\)"),
    ],
)
def test_rows_of_what_has_lost_a_value_are_refused(
    kept: dict[str, Any], asked: tuple[Source, Any], told: str, tmp_path: Path
) -> None:
    store, (source, made_of) = RowStore(tmp_path), asked
    settings = preset("mabc", TUNED)
    made_of = {"algorithm": "mabc", "max_steps": None} | as_record(settings) | made_of
    before = {"probes": {"last": LAST.way}, "source": as_json(asdict(PD))} | made_of
    path = tmp_path / "mine" / f"{OURS.name}.json"
    path.parent.mkdir()
    write_json(path, before)
    assert store.missing((PD, OURS), [0], [LAST], made_of, settings) == [0]
    write_json(path, before | kept)
    if "max_steps" in kept:  # which online is recorded where it is set only
        del made_of["max_steps"]
    with pytest.raises(OtherConfigError, match=told):
        store.missing((source, OURS), [0], [LAST], made_of, settings)


def test_a_probe_called_best_leaves_the_trainings_own_evaluation_alone() -> None:
    run = Path("run")
    files = [probe.file(run).name for probe in (LAST, BEST, Probe("best", "mine"))]
    assert files == ["eval.json", "eval_best.json", "eval_probe_best.json"]


def test_cells_and_probes_may_come_one_by_one() -> None:
    study = Study("x", (c for c in [("good-5k", OURS)]), (p for p in [LAST]))  # type: ignore[arg-type]
    assert study.cells == (("good-5k", OURS),) and study.probes == (LAST,)


def test_two_datasets_of_one_name_are_refused(tmp_path: Path) -> None:
    other = replace(OURS, name="other")
    study = Study("x", [(PD, OURS), (replace(PD, seed=9), other)])
    with pytest.raises(UsageError, match="two sources are called 'mine'"):
        study.run(tmp_path / "out", runs=tmp_path / "runs")


def test_older_rows_are_added_to(tmp_path: Path) -> None:
    """Their names end in .csv.gz."""
    store, cell = RowStore(tmp_path / "rows"), ("good-5k", OURS)
    store.keep(cell, {0: finished(tmp_path, 0)}, [LAST])
    evaluations, curves = store.evaluations(cell, [0], [LAST]), store.curves(cell, [0])
    for path in sorted(store.folder.rglob("*.csv.xz")):
        path.with_suffix(".gz").write_bytes(
            gzip.compress(lzma.decompress(path.read_bytes()))
        )
        path.unlink()
    assert store.evaluations(cell, [0], [LAST]) == evaluations
    assert repr(store.curves(cell, [0])) == repr(curves)  # nan is not nan
    store.keep(cell, {1: finished(tmp_path, 1)}, [LAST])
    assert len(store.evaluations(cell, [0, 1], [LAST])) == 4
    assert not list(store.folder.rglob("*.csv.gz"))


def test_evaluations_of_two_trainings_are_not_mixed(tmp_path: Path) -> None:
    store, cell = RowStore(tmp_path / "rows"), ("good-5k", OURS)
    one, other = (finished(tmp_path, 0, q_policy) for q_policy in (1.0, 2.0))
    store.keep(cell, {0: one}, [LAST, BEST])
    with pytest.raises(MarlMmError, match="of a training with another learning curve"):
        store.keep(cell, {0: other}, [LAST])
    store.keep(cell, {0: one}, [LAST])
    store.keep(cell, {0: other}, [LAST, BEST])  # nothing of the former one stays


def test_seeds_of_other_settings_are_not_mixed(tmp_path: Path) -> None:
    """As two processes might bring them, which began with no rows."""
    store, cell = RowStore(tmp_path / "rows"), ("good-5k", OURS)
    cell = cell[0], Setting("omar", "OMAR", "omar")
    runs = [finished(tmp_path, seed) for seed in (0, 1)]
    config = json.loads((runs[1] / "config.json").read_text())

    def keep_second(**changes: Any) -> None:
        (runs[1] / "config.json").write_text(json.dumps(config | changes))
        store.keep(cell, {1: runs[1]}, [LAST])

    store.keep(cell, {0: runs[0]}, [LAST])
    for name, value, was in (("updates", 999, "10"), ("bound_penalty", 0.001, "0.0")):
        with pytest.raises(OtherConfigError, match=rf"{name} = {was} \(now {value}\)"):
            keep_second(**{name: value})
    assert store.seeds(cell) == [0]
    keep_second(packages={"numpy": "9.9.9"}, precision="medium")
    assert store.seeds(cell) == [0, 1]


def test_a_probe_is_added_where_curves_of_some_seeds_lack_a_measure(
    tmp_path: Path,
) -> None:
    store, cell = RowStore(tmp_path / "rows"), ("good-5k", OURS)
    runs = {0: finished(tmp_path, 0, env_steps=0.0), 1: finished(tmp_path, 1)}
    store.keep(cell, runs, [LAST])
    store.keep(cell, runs, [BEST])
    assert len(store.evaluations(cell, [0, 1], [LAST, BEST])) == 8


def test_tasks_with_dots_have_files_of_their_own(tmp_path: Path) -> None:
    for name in ("My.A-v0", "My.B-v0"):
        write_cells(tmp_path / name, [], {})
    assert len(list(tmp_path.iterdir())) == 4


# --- The runner --------------------------------------------------------------


@pytest.mark.slow
def test_a_study_of_ones_own_is_made_once_and_checked(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "runs/results"
    assert main(words(own, runs, "--json")) == 0
    tables = json.loads(capsys.readouterr().out)
    settings, probes = ("width-16", "width-32"), ("last", "best", "held", "narrow")
    table = tables["widths"]
    cells = [(row["setting"], row["probe"]) for row in table]
    assert cells == list(product(settings, probes))
    for row in table:
        rows = read_rows(results / f"rows/sixty/{row['setting']}.csv.xz")
        own_rows = [each for each in rows if each["probe"] == row["probe"]]
        assert len(own_rows) == 2 * 2  # seeds, goals
        mean = sum(each["success"] for each in own_rows) / len(own_rows)
        assert row["success"] == pytest.approx(mean)
        assert all(each["alpha"] == 0.5 for each in own_rows) == (
            row["probe"] == "held"
        )
    assert all((results / file).stat().st_size > 200 for file in FILES)
    for probe, task in (("held", "Reach-v0"), ("narrow", "PreciseReach-v0")):
        evaluation = runs / f"sixty/width-16/0/eval_{probe}.json"
        assert json.loads(evaluation.read_text())["task"] == task

    assert main(words(own, runs, "--check")) == 0
    assert capsys.readouterr().out == f"{results / 'widths.csv'}: the same\n"
    assert main(words(own, runs, "--check", "--json")) == 0
    state = {str(results / "widths.csv"): "the same"}
    assert json.loads(capsys.readouterr().out) == state

    # From the rows alone, without any run: the same bytes.
    drawn = contents(results)
    redraw = ["--out", str(results), "--overwrite"]
    assert main(words(own, tmp_path / "nowhere", *redraw)) == 0
    assert contents(results) == drawn
    assert not (tmp_path / "nowhere").exists()

    (results / "widths.csv").write_text("another")
    assert main(words(own, runs, "--check")) == 1
    assert "widths.csv: not what" in capsys.readouterr().err
    assert main(words(own, runs)) == 2
    assert "exists already" in capsys.readouterr().err
    # Another declaration of the same name does not take these rows for its own.
    matd3 = 'algorithm="matd3-bc", changes'
    for old, new, what in (
        ("(n, n)", "(n, n + 1)", "hidden = [16, 16] (now [16, 17])"),
        ("alpha=0.5", "alpha=0.6", "probes.held.alpha = 0.5 (now 0.6)"),
        ("changes", matd3, "algorithm = td3-bc (now matd3-bc)"),
    ):
        own.write_text(OWN.replace(old, new))
        assert main(words(own, runs, "--overwrite")) == 2
        complaint = capsys.readouterr().err
        assert what in complaint and "name another folder with --out" in complaint


@pytest.mark.slow
def test_a_run_that_fails_does_not_stop_the_others(
    own: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train = Learner.train

    def short_of_memory(learner: Learner, *arguments: Any) -> None:
        if learner.training.config.batch_size == 4321:
            raise MemoryError
        train(learner, *arguments)

    monkeypatch.setattr(Learner, "train", short_of_memory)
    asked = words(own, tmp_path / "runs")
    asked[1] = f"{own}:FAILS"
    assert main(asked) == 1
    complaint = capsys.readouterr().err
    assert "2 of 4 runs failed, the same with --resume tries" in complaint
    assert "huge/1: " in complaint and "MemoryError" in complaint
    assert (tmp_path / "runs/results/rows/sixty/width-16.csv.xz").exists()
    assert main([*asked, "--settings", "width-16"]) == 0
    assert (tmp_path / "runs/results/fails-part.csv").exists()
    assert not (tmp_path / "runs/results/fails.csv").exists()
    assert main([*asked, "--settings", "width-16", "--check"]) == 2
    both = study_of(own, "FAILS")

    def draw(options: StudyOptions, bar: Bar) -> list[Row]:
        names = (cell_name(c)[1] for c in both.cells if options.store.seeds(c))
        return [{"kept": name} for name in names]

    of_both = Comparison("Both.", "both.csv", draw, lambda *_: None, str, both)
    monkeypatch.setitem(COMPARISONS, "both", of_both)
    capsys.readouterr()
    asked[1] = "both"
    assert main([*asked, "--resume", "--json"]) == 1
    shown = capsys.readouterr()
    assert json.loads(shown.out) == {"both": [{"kept": "width-16"}]}
    assert "2 of 2 runs failed" in shown.err


@pytest.mark.slow
def test_runs_that_diverged_are_marked(own: Path, tmp_path: Path) -> None:
    """Also after those of other seeds came to the same rows."""
    asked = words(own, tmp_path / "runs")
    asked[1] = f"{own}:DIVERGES"
    alone = asked.copy()
    alone.remove("1")  # the second seed
    assert main(alone) == 0
    assert main([*asked, "--resume"]) == 0
    results = tmp_path / "runs/results"
    (row,) = read_rows(results / "diverges.csv")
    assert row["diverged"] == "0 after 0, 1 after 0" and np.isnan(row["q_slope"])


def found_in(folder: Path, name: str) -> list[str]:
    """Files of that name while another process makes and removes folders.

    `Path.rglob` fails when a folder is gone before it is read.
    """
    return glob.glob(f"**/{name}", root_dir=folder, recursive=True)


def unfinished(runs: Path) -> list[Path]:
    """Runs between their first checkpoint and their end."""
    begun = [runs / Path(path).parent for path in found_in(runs, "checkpoint.pt")]
    return [run for run in begun if not (run / "eval.json").exists()]


@pytest.mark.slow
def test_killing_it_again_and_again_changes_nothing(
    own: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    """Four times while it is at work, before and after checkpoints."""
    asked = words(own, tmp_path / "killed", "--resume", "--workers", "2")
    moments, killed, cut = random.Random(0), 0, 0
    context = get_context("forkserver")  # which imports everything once
    context.set_forkserver_preload(["marl_mm.commands.ablate"])
    while killed < 4:
        job = context.Process(target=main, args=(asked,))
        job.start()
        while killed % 2 and job.is_alive() and not unfinished(tmp_path / "killed"):
            time.sleep(0.02)  # every second time when a run is in the middle
        job.join(moments.uniform(0.0, 0.2 if killed % 2 else 4.0))
        job.kill()
        job.join()
        if job.exitcode != -signal.SIGKILL:  # it was done: once more from the start
            assert job.exitcode == 0
            shutil.rmtree(tmp_path / "killed")
        killed += job.exitcode == -signal.SIGKILL
        cut += bool(unfinished(tmp_path / "killed"))
    assert cut > 0  # some of them between the first checkpoint and the end
    assert main(asked) == 0
    assert contents(tmp_path / "killed/results") == whole


@pytest.mark.slow
def test_ctrl_c_in_the_middle_of_a_run_loses_nothing(
    own: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    asked = words(own, tmp_path / "stopped", "--workers", "2")
    with Fork(*asked) as job:
        while not unfinished(tmp_path / "stopped"):
            assert job.running()
            time.sleep(0.02)
        os.killpg(job.pid, signal.SIGINT)  # as a terminal does: workers hear it, too
        assert job.wait() == 130
        complaint = job.complaint
    assert "go on with --resume" in complaint and "Traceback" not in complaint
    assert not (tmp_path / "stopped/results/widths.csv").exists()
    assert main([*asked, "--resume"]) == 0
    assert contents(tmp_path / "stopped/results") == whole


@pytest.mark.slow
def test_a_killed_worker_does_not_stop_it(
    own: Path, tmp_path: Path, workers_of: WorkersOf
) -> None:
    asked = words(own, tmp_path / "runs", "--workers", "2")
    with Fork(*asked) as job:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not found_in(tmp_path, "metrics.jsonl"):
            time.sleep(0.05)
        workers_of(job.pid)[0].kill()
        assert job.wait() == 0
    assert all((tmp_path / "runs/results" / file).exists() for file in FILES)


class Done(Job):
    """A run of which nothing is missing."""

    def has(self, probe: Probe) -> bool:
        return True


class Deadly(Job):
    """A run that ends the process that takes it up."""

    def has(self, probe: Probe) -> bool:
        os._exit(1)


def job_of(kind: type[Job], run: Path) -> Job:
    learner = Learner(default_training("mabc"), load_dataset("good-5k").location)
    return kind(("good-5k", OURS), 0, run, learner, (LAST,))


@pytest.mark.slow
def test_a_run_that_kills_its_process_takes_no_other_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2]))  # for the processes
    jobs = [
        job_of(kind, tmp_path / str(number))
        for number, kind in enumerate((Done, Deadly, Done, Done))
    ]
    done: list[Job] = []
    messages: list[str] = []
    failed = do_jobs(jobs, 2, "local", done.append, messages.append, silent_bar)
    assert failed.keys() == {tmp_path / "1"}
    assert "a worker process died" in failed[tmp_path / "1"]
    assert "going on with" in messages[0]
    assert sorted(job.run.name for job in done) == ["0", "2", "3"]


@pytest.mark.slow
def test_on_a_gpu_a_process_does_all_runs_of_a_cell(tmp_path: Path) -> None:
    location = load_dataset("good-5k").location
    learner = Learner(default_training("mabc", device="cuda"), location)
    jobs = [
        Done((name, OURS), seed, tmp_path / name / str(seed), learner, (LAST,))
        for name in ("one", "other")
        for seed in (0, 1, 2)
    ]
    assert [len(group) for group in _by_process(jobs)] == [3, 3]
    done: list[Job] = []
    assert not do_jobs(jobs, 2, "local", done.append, lambda text: None, silent_bar)
    assert {job.run for job in done} == {job.run for job in jobs}


@pytest.mark.slow
def test_of_runs_side_by_side_one_that_fails_is_the_only_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are on a CPU here, and evaluated one by one after all are trained."""
    monkeypatch.setattr(Offline, "side_by_side", True)
    training = training_of("good-5k", OURS, None, small=True)
    learner = Learner(training, load_dataset("good-5k").location)
    held = Probe("held", "alpha held", alpha=0.5)
    jobs = [
        Job(("good-5k", OURS), seed, tmp_path / str(seed), learner, (LAST, held))
        for seed in (0, 1)
    ]
    probe = studies_jobs._probe

    def full_disk(job: Job, probed: Probe) -> None:
        if job.seed == 0:
            raise OSError("no space")
        probe(job, probed)

    monkeypatch.setattr(studies_jobs, "_probe", full_disk)
    _begin(None, None)
    assert _do(jobs) == (tmp_path / "0", ["OSError: no space", ""])
    assert [held.file(job.run).exists() for job in jobs] == [False, True]
    assert all(job.trained for job in jobs)


@pytest.mark.slow
def test_a_run_whose_rows_cannot_be_kept_counts_as_failed(tmp_path: Path) -> None:
    def refuse(job: Job) -> None:
        raise MarlMmError("other rows")

    failed = do_jobs(
        [job_of(Done, tmp_path)], 1, "local", refuse, lambda text: None, silent_bar
    )
    assert failed == {tmp_path: "other rows"}


@pytest.mark.slow
def test_a_plan_says_what_is_missing_and_trains_nothing(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["ablate", f"{own}:WIDTHS", "--runs", str(tmp_path / "runs"), "--plan"]
    assert main([*asked, "--seeds", "0", "--workers", "1"]) == 0
    *_, total, _, cost = capsys.readouterr().out.splitlines()
    _, what, _, missing, hours, _ = total.split("|")
    assert (what.strip(), missing.strip()) == ("all", "2 of 2")
    assert 0.001 < float(hours) < 1.0
    on_2, on_16, on_64 = (float(h) for h in re.findall(r"([\d.]+) on", cost))
    assert float(hours) >= on_2 >= on_16 == on_64  # each of two runs has a core
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
@pytest.mark.parametrize("target", ["all", "paper"])
def test_a_plan_of_several_targets_trains_nothing_either(
    target: str,
    datasets_home: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked = ["ablate", target, "--plan", "--budget", "smoke", "--runs", str(tmp_path)]
    assert main([*asked, "--seeds", "0"]) == 0
    *_, total = capsys.readouterr().out.splitlines()
    studies = [STUDIES[name] for name in GROUPS[target] if name in STUDIES]
    cells = {cell_name(cell) for study in studies for cell in study.cells}
    assert f"| {len(cells)} of {len(cells)} |" in total
    assert not list(tmp_path.glob("[!d]*"))  # but its home of datasets


@pytest.mark.parametrize("name", ["gate-expert", "bar-conventions"])
def test_quick_runs_on_a_named_dataset_have_steps_enough(
    name: str, datasets_home: Path, tmp_path: Path
) -> None:
    """Nobody gets to these tasks' goals in so few as a quick run of Reach has."""
    file = tmp_path / "own.py"
    file.write_text(
        "from marl_mm.eval.studies.settings import setting_of\n"
        "from marl_mm.eval.studies.study import Study\n"
        f"OWN = Study('x', [('{name}', setting_of('own', 'bc', 10))])\n"
    )
    asked = ["ablate", f"{file}:OWN", "--engine", "mujoco", "--budget", "smoke"]
    assert main([*asked, "--plan", "--runs", str(tmp_path / "runs")]) == 0


@pytest.mark.slow
def test_a_plan_says_what_is_collected_first(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = tmp_path / "runs"
    for name, deed in (
        ("offline", "30000 steps of pretrained in Reach-v0 are collected"),
        ("tasks", "30000 steps of pretrained in SmoothReach-v0 are collected"),
    ):
        asked = ["ablate", name, "--plan", "--runs", str(runs), "--seeds", "0"]
        assert main([*asked, "--settings", "mabc"]) == 0
        text = capsys.readouterr()
        assert f"{deed} first" in text.err
        *_, total, _, _ = text.out.splitlines()
        cells = len([c for c in STUDIES[name].cells if c[1].name == "mabc"])
        assert f"| {cells} of {cells} |" in total and float(total.split("|")[-2]) > 0
    assert not runs.exists()


EVERYTHING = """
from marl_mm.eval.studies import BEST, LAST, Mix, Online, Setting, Source, Study

FEW = {"hidden": (16, 16)}
IMITATED = Setting("few", "few", changes=FEW)
HINDSIGHT = Setting("her", "hindsight", "ddpg-her", changes=FEW)
ROOM = {"alpha_rule": "room"}
PD = Source("pd", steps=60, settings=ROOM, name="shown", engine="mujoco")
ANY = Mix("any", [(PD, 40), (Source("random", steps=60, engine="mujoco"), 40)])
ALL = Study(
    "Every way to learn.",
    [
        (PD, IMITATED),
        (ANY, IMITATED),
        (Online(), HINDSIGHT),
        (Online(demonstrations=PD), HINDSIGHT),
    ],
    probes=(LAST, BEST),
    figure=True,
    seeds=1,
)
"""
"""A study of everything that a cell can learn from."""


@pytest.mark.slow
def test_python_and_the_command_make_the_same_of_every_way_to_learn(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "everything.py"
    path.write_text(EVERYTHING)
    runs = tmp_path / "command"
    small = ["--budget", "smoke", "--workers", "1", "--runs", str(runs)]
    assert main(["ablate", f"{path}:ALL", *small, "--engine", "mujoco"]) == 0
    text = capsys.readouterr()
    assert "30 steps of pd" not in text.out and "30 steps of pd in Reach" in text.err
    names: dict[str, Any] = {}
    exec(EVERYTHING, names)
    same: dict[str, Any] = {"name": "all", "budget": "smoke", "engine": "mujoco"}
    table = names["ALL"].run(runs=tmp_path / "python", **same)
    assert capsys.readouterr() == ("", "")
    assert contents(tmp_path / "python/results") == contents(runs / "results")
    sources = ["shown", "any", "online-Reach-v0", "online-Reach-v0-shown"]
    rows = [(row["dataset"], row["probe"]) for row in table.rows]
    assert rows == [*product(sources, ("last", "best"))]
    assert table.markdown() in text.out
    page = table._repr_html_()
    assert "<table>" in page and "image/png" in page
    with pytest.raises(UsageError, match="exists already"):
        names["ALL"].run(runs=tmp_path / "python", **same)


@pytest.mark.slow
def test_what_there_is_no_data_for_is_collected_first(
    own: Path,
    datasets_home: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Also the rest of a collection that was stopped, or was to be shorter; stdout is
    the table alone."""
    tiny = Source(steps=60, name="tiny", engine="mujoco")
    short: dict[str, Any] = {"dataset": "tiny", "engine": "mujoco", "workers": 1}

    def stopped(label: str, total: int) -> Advance:
        def advance(done: int, note: str) -> None:
            if done:
                raise KeyboardInterrupt

        return advance

    with pytest.raises(KeyboardInterrupt):
        marl_mm.collect("pd", steps=60, progress=stopped, **short)
    assert 0 < load_dataset("tiny").arrays.steps < 60
    messages: list[str] = []
    made = Datasets(notify=messages.append)
    with pytest.raises(UnknownDatasetError, match="60 steps of pd in Reach-v0 are"):
        made.find(tiny)
    assert made.make(tiny).arrays.steps >= 60
    assert "tiny is not complete, or is another one: 60 steps" in messages.pop()
    assert made.find(tiny).fingerprint == made.make(tiny).fingerprint and not messages
    shutil.rmtree(load_dataset("tiny").location.folder)
    marl_mm.collect("pd", steps=30, **short)
    assert made.make(tiny).arrays.steps >= 60
    assert "tiny is not complete" in messages.pop()
    with pytest.raises(OtherConfigError, match=r"seed.*: marl-mm datasets delete "):
        made.make(replace(tiny, steps=90, seed=1))
    shutil.rmtree(load_dataset("tiny").location.folder)
    capsys.readouterr()
    asked = ["ablate", f"{own}:TINY", "--seeds", "0", "--workers", "1", "--json"]
    assert main([*asked, "--runs", str(tmp_path / "runs")]) == 0
    text = capsys.readouterr()
    assert json.loads(text.out)["tiny"][0]["goals"] == 2
    plan, collection = "1 of 1 runs are missing", "tiny is not there: 60 steps of pd"
    assert plan in text.err and collection in text.err.split(plan)[1], "the plan first"
    assert load_dataset("tiny").arrays.steps >= 60


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        (["own.py:WIDTH"], "has no Study called 'WIDTH', expected one of WIDTHS, F"),
        (["none.py:WIDTHS"], "there is no file"),
        (["broken.py:X"], "broken.py cannot be run: ZeroDivisionError: division by"),
        (["odd.py:X"], "odd.py: setting 'own': td3-bc has no setting 'hiden'"),
        (
            ["own.py:WIDTHS", "--settings", "width-8"],
            "--settings has no 'width-8': exp",
        ),
        (["own.py:WIDTHS", "--datasets"], "--datasets is empty: expected sixty"),
        (["own.py:WIDTHS", "--seeds", "0", "0"], "seeds"),
        (["all", "--settings", "td3-bc"], "--settings are for a study, not all"),
        (["own.py:ELSEWHERE"], "no dataset marl_mm/reach/none-v0"),
        (
            ["own.py:WIDTHS", "--settings", "width-16", "--check"],
            "--check is for whole tables",
        ),
        (["own.py:WIDTHS", "--plan", "--check"], "--check is for whole tables"),
        (
            ["cures", "--datasets", "pd-30k", "--settings", "matd3-bc"],
            "--settings matd3-bc are not run on --datasets pd-30k",
        ),
    ],
)
def test_what_cannot_be_made_is_told_in_one_line(
    asked: Sequence[str],
    complaint: str,
    own: Path,
    datasets_home: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(own.parent)
    Path("broken.py").write_text("1 / 0")
    Path("odd.py").write_text(
        "from marl_mm.eval.studies import Setting\n"
        "Setting('own', 'own', changes={'hiden': (8, 8)})\n"
    )
    assert main(["ablate", *asked]) == 2
    messages = capsys.readouterr().err
    assert complaint in messages and messages.count("\n") == 1
