"""Registries: names, order, origins, and what they refuse."""

import subprocess
import sys

import pytest

from marl_mm.algorithms.registry import ALGORITHMS, names, preset
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.registry import TASKS
from marl_mm.errors import UsageError
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


@pytest.mark.parametrize("name", ["", "a b", "a/b", "a\nb"])
def test_names_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="expected a name without spaces"):
        Registry[int]("number").add(name, 1)


def test_an_unknown_name_is_told_all_and_the_nearest() -> None:
    with pytest.raises(UsageError) as refused:
        ALGORITHMS.get("mabs")
    told = str(refused.value)
    assert told.startswith("unknown algorithm 'mabs', expected one of mabc, td3-bc, ")
    assert "did you mean mabc?" in told and told.endswith("needs --plugin")


def test_what_is_built_in_comes_in_one_order_whatever_was_imported_first() -> None:
    code = (
        "import marl_mm.{first}; from marl_mm.{kind}.registry import {registry} as r;"
        "print(*r.names(), {{r.origin(name) for name in r.names()}})"
    )
    told = {
        subprocess.run(
            [sys.executable, "-c", code.format(first=first, kind=kind, registry=name)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kind, name in (("collectors", "COLLECTORS"),)
        for first in ("collectors.random", "collectors.scripted", "registry")
    }
    assert told == {f"pretrained pd medium random scripted {{'{BUILT_IN}'}}\n"}


def test_gymnasium_knows_every_task() -> None:
    import gymnasium

    for name in TASKS.names():
        assert gymnasium.spec(f"marl_mm/{name}").kwargs["task"] == name


def test_a_preset_that_an_algorithm_has_not_is_refused() -> None:
    assert set(names(online=True)) | set(names(online=False)) == set(ALGORITHMS.names())
    with pytest.raises(UsageError, match="--preset is 'tunde', expected one of tuned"):
        preset("mabc", "tunde")


def test_every_collectors_config_has_defaults() -> None:
    for _, collector in COLLECTORS.items():
        assert collector.config() == collector.config()
