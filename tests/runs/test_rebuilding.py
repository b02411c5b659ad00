"""Cards that are rebuilt: what is wrong with one is said in a line, before any step."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.collectors.pd import PdConfig
from marl_mm.datasets.card import kept_card
from marl_mm.declared import as_record
from marl_mm.progress import Advance
from marl_mm.runs import rebuilding
from marl_mm.runs.settings import flat, with_settings


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The card of a dataset that ships."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("datasets")))
        return kept_card(marl_mm.load_dataset("gate-expert"))


def refusal(values: Any, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What `datasets rebuild` says of a card, in a line, with exit code 1."""
    path = folder / "card.json"
    path.write_text(json.dumps(values))
    assert main(["datasets", "rebuild", str(path), "--workers", "1"]) == 1
    told = capsys.readouterr()
    assert told.out == "" and told.err.count("\n") == 1
    assert "Traceback" not in told.err and str(path) in told.err
    return told.err


@dataclass(frozen=True)
class Nested:
    """Settings, with those of another collector among them."""

    lowest: float = 0.1

    pd: PdConfig = field(default_factory=PdConfig)

    sizes: tuple[int, ...] | None = (1,)


def test_nested_settings_come_back_from_their_record() -> None:
    mine = Nested(0.2, PdConfig(kp=8.0))
    assert with_settings("it", Nested(), flat(as_record(mine))) == mine
    half: Any = np.float32(0.5)
    numbers = Nested(half, PdConfig(kp=half))
    taken = with_settings("it", numbers, {})
    assert [type(value) for value in (taken.lowest, taken.pd.kp)] == [float, float]
    several: Any = [np.int64(2), 3]
    assert with_settings("it", mine, {"sizes": several}).sizes == (2, 3)
    assert with_settings("it", mine, {"sizes": None}).sizes is None


@pytest.mark.slow
def test_episodes_may_be_longer_than_the_tasks(datasets_home: Path) -> None:
    longer: dict[str, Any] = {"max_steps": 40, "random_steps": 30, "engine": "mujoco"}
    made = marl_mm.collect("medium", dataset="long", steps=1, workers=1, **longer)
    before, again = rebuilding.rebuild("long")
    assert before == again == made.metadata["marl_mm"]["data_sha256"]


def test_what_was_stopped_is_not_rebuilt(
    card: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refusal(card | {"complete": False}, tmp_path, capsys)
    assert "a collection that was stopped: finish it first" in told


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"steps": "x"}, "made_of: steps: str is not an instance of int"),
        ({"steps": True}, "made_of: steps: True is not a whole number"),
        ({"steps": 0}, "card.json: steps is 0, expected >= 1"),
        ({"seed": None}, "made_of: seed: None is not an instance of int"),
        ({"seed": -1}, "the seed is -1, expected >= 0"),
        ({"overrides": None}, "made_of: overrides: None is not a dict"),
        ({"overrides": {"goal_x": [0, 1]}}, "overrides has 'goal_x', which is not"),
        ({"overrides": {"max_steps": "9"}}, "max_steps: str is not an instance of int"),
        ({"overrides": {"simulation": 3}}, "simulation: int is not a dict"),
        ({"overrides": {"simulation": {"engine": []}}}, "engine is [], expected of"),
        (
            {"overrides": {"simulation": {"step": 1}}},
            "has 'step', which is not rebuilt",
        ),
        ({"task": "Gat-v0"}, "unknown task 'Gat-v0'"),
        ({"task": ["Gate-v0"]}, "made_of: task: list is not an instance of str"),
        ({"collector": 7}, "made_of: collector: int is not an instance of str"),
        ({"collector": "scriptet"}, "did you mean scripted?"),
        ({"collector_config": 3}, "made_of: collector_config: int is not a dict"),
        (
            {"collector_config": {"kq": 1}},
            "has no setting 'kq', expected some of alpha",
        ),
        ({"collector_config": {"kp": "1"}}, "kp is '1', expected a number"),
        ({"packages": None}, "made_of: packages: None is not a dict"),
        ({"packages": {"numpy": 2}}, "packages: value of key 'numpy' of dict is not"),
        ({"agent": "w"}, "made_of has 'agent', which is not rebuilt"),
        ({"weights": 3}, "made_of: weights: int is not an instance of str"),
    ],
)
def test_each_part_of_a_card_is_checked(
    changes: dict[str, Any],
    expected: str,
    card: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rebuilding, "collect_dataset", lambda *_, **__: 1 / 0)
    values = card | {"made_of": card["made_of"] | changes}
    assert expected in refusal(values, tmp_path, capsys)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([], "list is not a dict"),
        (None, "None is not a dict"),
        ({}, "does not say what its dataset is made of"),
        ({"made_of": 3}, "does not say what its dataset is made of"),
        ({"data_sha256": None}, "does not say what its dataset is made of"),
        ({"id": None}, "id is None, expected a dataset's id"),
        ({"id": "../x"}, "id is '../x', expected a dataset's id"),
    ],
)
def test_a_card_is_an_object_with_id_and_hash(
    values: Any,
    expected: str,
    card: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    values = card | values if values else values
    assert expected in refusal(values, tmp_path, capsys)


def test_what_is_no_card_is_refused(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, says in (
        (str(tmp_path / "none.json"), "none.json, expected a card or a dataset"),
        ("gate-noisy", "make it with marl-mm datasets build gate-noisy"),
    ):
        assert main(["datasets", "rebuild", name]) > 0
        error = capsys.readouterr().err
        assert says in error and error.count("\n") == 1


def test_packages_that_differ_are_named_with_both_versions(
    card: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "card.json"
    made_of = {**card["made_of"], "packages": {"numpy": "0.1", "no-such": "1"}}
    path.write_text(json.dumps(card | {"made_of": made_of}))
    numpy, other = rebuilding.read_card(path).differing_packages
    assert numpy.startswith("numpy 0.1, here ") and other == "no-such 1, here None"


def test_a_rebuild_that_is_stopped_says_nothing_of_the_data(
    card: dict[str, Any], tmp_path: Path
) -> None:
    def stopped(label: str, total: float) -> Advance:
        def advance(amount: float, text: str) -> None:
            if amount:
                raise KeyboardInterrupt

        return advance

    path = tmp_path / "card.json"
    path.write_text(json.dumps(card))
    with pytest.raises(KeyboardInterrupt, match="nothing is kept"):
        rebuilding.rebuild(path, progress=stopped)
