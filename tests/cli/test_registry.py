"""Registries: names, order, origins, and what they refuse."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm, names, preset
from marl_mm.cli import main
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.envs.registry import TASKS, register_task
from marl_mm.envs.tasks.reach import Reach
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.metrics import METRICS, Metric, summarize
from marl_mm.eval.tables import header, table_rows
from marl_mm.registry import BUILT_IN, Registry, registered_by


def test_things_come_in_the_order_of_adding_with_their_origin() -> None:
    registry: Registry[int] = Registry("number")
    registry.add("two", 2)
    with registered_by("plugin.py"):
        registry.add("one", 1)
    assert registry.names() == ("two", "one")
    assert registry.items() == (("two", 2), ("one", 1))
    assert registry.origin("one") == "plugin.py"
    assert registry.origin("two") == __name__
    assert "one" in registry and "three" not in registry


def test_a_module_that_could_not_be_imported_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    registry: Registry[int] = Registry("number", modules=["fails_once", "json"])
    (tmp_path / "fails_once.py").write_text("raise KeyboardInterrupt")
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            registry.names()


def test_what_a_plugin_loads_itself_is_not_its_own() -> None:
    registry: Registry[int] = Registry("number")
    with registered_by("outer.py"), registered_by("inner.py"):
        registry.add("one", 1)
    assert registry.origin("one") == "inner.py"


def test_nothing_of_a_plugin_that_fails_stays() -> None:
    """But of others that it had loaded, and what it had replaced."""
    registry: Registry[int] = Registry("number")
    with registered_by("plugin.py"):
        registry.add("one", 1)
    with pytest.raises(KeyError), registered_by("plugin.py"):
        with registered_by("inner.py"):
            registry.add("inner", 3)
        registry.add("one", 10)
        registry.add("two", 2)
        raise KeyError
    assert registry.items() == (("one", 1), ("inner", 3))
    with registered_by("other.py"):
        registry.add("two", 20)


def test_what_a_failed_plugin_made_the_package_import_stays(tmp_path: Path) -> None:
    code = """
import pathlib, sys
from marl_mm import plugins
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.envs.registry import TASKS
from marl_mm.errors import PluginError

folder = pathlib.Path(sys.argv[1])
try:
    plugins.load(folder / "plug.py")
except PluginError as error:
    print(error)
print("mabc" in ALGORITHMS, "Mine-v0" in TASKS)
(folder / "plug.py").write_text("import helper_of_mine")
plugins.load(folder / "plug.py")
print("Mine-v0" in TASKS)
"""
    (tmp_path / "helper_of_mine.py").write_text(
        "from marl_mm.envs import register_task\n"
        "from marl_mm.envs.tasks.reach import Reach\n"
        "register_task('Mine-v0', Reach())\n"
    )
    (tmp_path / "plug.py").write_text(
        "import helper_of_mine\n"
        "from marl_mm.algorithms.registry import ALGORITHMS\n"
        "raise KeyError(len(ALGORITHMS.names()))\n"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    assert "plug.py fails: KeyError" in printed[0]
    assert printed[1:] == ["True False", "True"]


def test_a_name_belongs_to_who_came_first() -> None:
    registry: Registry[int] = Registry("number")
    registry.add("one", 1)
    registry.add("one", 10)  # a module that is run again may change its mind
    assert registry.get("one") == 10
    with (
        registered_by("other.py"),
        pytest.raises(UsageError, match=r"'one' of other\.py exists"),
    ):
        registry.add("one", 2)
    assert registry.get("one") == 10


@pytest.mark.parametrize("name", ["", "a b", "a/b", "a\nb", "2nd", "-a"])
def test_names_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="expected a letter and then letters"):
        Registry[int]("number").add(name, 1)


def test_an_unknown_name_is_told_all_and_the_nearest() -> None:
    with pytest.raises(UsageError) as refused:
        ALGORITHMS.get("mabs")
    text = str(refused.value)
    known = "unknown algorithm 'mabs' (did you mean mabc?), expected one of bc, mabc, "
    assert text.startswith(known)
    assert text.endswith("needs `marl_mm.plugins.load(...)`")


def test_of_a_level_that_is_no_task_all_levels_are_named() -> None:
    near = "did you mean Gate-easy-v0, Gate-v0, Gate-hard-v0 or Gate-halves-v0?"
    with pytest.raises(UsageError, match=re.escape(near)):
        TASKS.get("Gate-medium-v0")


def test_what_is_built_in_comes_in_one_order_whatever_was_imported_first() -> None:
    code = (
        "import marl_mm.{first}; from marl_mm.{kind}.registry import {registry} as r;"
        "print(*r.names(), {{r.origin(name) for name in r.names()}})"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", code.format(first=first, kind=kind, registry=name)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kind, name in (("collectors", "COLLECTORS"),)
        for first in ("collectors.random", "collectors.scripted", "registry")
    }
    assert outputs == {
        f"pretrained pd medium random scripted varied {{'{BUILT_IN}'}}\n"
    }


def test_gymnasium_knows_every_task() -> None:
    import gymnasium

    for name in TASKS.names():
        assert gymnasium.spec(f"marl_mm/{name}").kwargs["task"] == name


def test_a_preset_that_an_algorithm_has_not_is_refused() -> None:
    assert set(names(online=True)) | set(names(online=False)) == set(ALGORITHMS.names())
    with pytest.raises(UsageError, match="`preset` is 'tunde', expected one of tuned"):
        preset("mabc", "tunde")


def test_every_collectors_config_has_defaults() -> None:
    for _, collector in COLLECTORS.items():
        assert collector.config() == collector.config()


# --- Declarations ------------------------------------------------------------


@dataclass(frozen=True)
class Demanding:
    """One of its settings has no default."""

    period: float


@dataclass(frozen=True)
class Records(MabcConfig):
    """One of its settings has the name of what a run records."""

    plugins: int = 9


@dataclass(frozen=True)
class Steps:
    """One of its settings has the name of an option of every collection."""

    steps: int = 9


@dataclass(frozen=True)
class Json:
    """One of its settings has the name of an option of the command."""

    json: int = 9


def collector(config: type) -> Collector:
    return Collector(
        about="x", config=config, policy=lambda config, task: RandomPolicy(config)
    )


def algorithm(config: Any, online: bool = False) -> Algorithm:
    return Algorithm(
        about="x", source="x", learner=Mabc, presets={TUNED: config}, online=online
    )


@pytest.mark.parametrize(
    ("declare", "complaint"),
    [
        (lambda: collector(Demanding), r"Demanding\.period has no default"),
        (lambda: collector(Steps), r"Steps\.steps has the name of something"),
        (lambda: collector(dict), "no dataclass, expected a frozen one"),
        (lambda: algorithm({"updates": 1}), "no dataclass, expected a frozen one"),
        (lambda: algorithm(Steps()), "Steps has no updates, precision"),
        (lambda: algorithm(MabcConfig(), online=True), "has no episodes, episodes_per"),
        (lambda: algorithm(Records()), r"Records\.plugins has the name of something"),
        (
            lambda: METRICS.add("some", len),  # type: ignore[arg-type]
            "expected a marl_mm.eval.metrics.Metric",
        ),
        (lambda: COLLECTORS.add("paper", collector(RandomConfig)), "other than paper"),
        (
            lambda: METRICS.add("success", Metric(about="x", value=len)),
            "other than direction, episodes, failures, goal, index, inter",
        ),
    ],
)
def test_declarations_that_would_break_something_later_are_refused(
    declare: Callable[[], object], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        declare()


@dataclass(frozen=True, kw_only=True)
class Undecided(Reach):
    """One of its numbers has no default."""

    width: float


def test_tasks_need_defaults_and_a_layout() -> None:
    with pytest.raises(UsageError, match=r"Undecided\.width has no default"):
        register_task("Undecided-v0", Undecided(max_steps=2, width=1.0))
    assert "Undecided-v0" not in TASKS


@dataclass(frozen=True, kw_only=True)
class Untyped(Reach):
    """A number that has no type is no field."""

    max_steps = 40


class Undecorated(Reach):
    """Nor is one of a class that is no dataclass."""

    width: float = 2.0


@pytest.mark.parametrize(
    ("kind", "complaint"),
    [
        (Untyped, "Untyped.max_steps has no effect without a type: .* max_steps: int"),
        (Undecorated, r"Undecorated.width has no effect: write @dataclass\("),
    ],
)
def test_what_looks_like_a_field_of_a_task_is_one(
    kind: type[Reach], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        register_task("Untyped-v0", kind())
    assert "Untyped-v0" not in TASKS


@pytest.mark.parametrize("name", ["Reach", "Mine", "Mine-v01", "Mine-v", None])
def test_tasks_are_named_with_a_version(name: Any) -> None:
    """Gymnasium would refuse some of these, or call them otherwise."""
    with pytest.raises(UsageError, match=r"expected a version, such as \w+"):
        register_task(name, Reach())
    assert name not in TASKS


def test_options_of_the_same_name_are_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "clash" not in COLLECTORS
    monkeypatch.setitem(COLLECTORS._things, "clash", collector(Json))
    assert main(["collect", "clash"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith("marl-mm: Json.json has the name of something else")


def test_a_collector_may_be_called_as_an_option_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "task" not in COLLECTORS
    monkeypatch.setitem(COLLECTORS._things, "task", collector(RandomConfig))
    words = ["eval", "task", "--episodes", "2", "--max-steps", "1", "--workers", "1"]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["policy"] == "task"


def test_what_few_episodes_have_is_averaged_over_these(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    some = Metric(about="x", value=len, averaged=True)
    monkeypatch.setitem(METRICS._things, "some", some)
    rows = [{"success": True, "steps": 1, "return": 0.0} for _ in range(3)]
    rows[1]["some"] = 4.0
    assert summarize(rows)["some"] == 4.0


def test_a_metric_with_a_column_stands_in_tables(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    short = evaluate(RandomPolicy(RandomConfig()), 2, overrides={"max_steps": 1})
    assert header()[-1] == "alpha"
    length = Metric(about="x", value=len, averaged=True, column="length", form=".1f")
    monkeypatch.setitem(METRICS._things, "length", length)
    again = evaluate(RandomPolicy(RandomConfig()), 2, overrides={"max_steps": 1})
    assert header()[-1] == "length"
    assert [row[-1] for row in table_rows([again])] == ["1.0", "1.0", "1.0"]
    assert [row[-1] for row in table_rows([short])] == ["-", "-", "-"]
