"""Named datasets: recipes that give the same bytes, and say when they do not."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.datasets.card import keep_card
from marl_mm.datasets.named import AXES, name_of, named_ids
from marl_mm.datasets.shipped import IDS
from marl_mm.errors import DatasetError, UsageError
from marl_mm.runs import recipes
from marl_mm.runs.making import Datasets
from marl_mm.runs.rebuilding import rebuild
from marl_mm.runs.recipes import (
    RECIPES,
    Recipe,
    build_dataset,
    catalogue_rows,
    recorded,
)
from marl_mm.runs.sources import Source

SMALL = "small-noisy"


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A recipe of few steps, and a folder for datasets and for the record."""
    record = tmp_path / "recipes.json"
    record.write_text("{}")
    monkeypatch.setattr(recipes, "RECORD", record)
    settings = {"noise": 0.2, "noise_memory": 0.5}
    source = Source(
        *("varied", "MovingReach-v0", 60), 3, settings, "marl_mm/small/noisy-v0"
    )
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    recipe = Recipe(axis="noisy", source=replace(source, engine="mujoco"))
    RECIPES.add(SMALL, recipe)
    yield record
    RECIPES._things.pop(SMALL)
    RECIPES._origins.pop(SMALL)


def put(record: Path, **changes: Any) -> None:
    row = build_dataset(SMALL).row | changes
    record.write_text(json.dumps({SMALL: row}))


def test_every_recipe_is_of_a_kind_on_an_engine_and_of_some_size() -> None:
    assert len(RECIPES.names()) >= 24
    for name, recipe in RECIPES.items():
        assert recipe.axis in AXES and recipe.source.engine == "mujoco"
        assert 10_000 <= recipe.source.steps <= 50_000
        assert recipe.name == name
    prints = [recipe.fingerprint for _, recipe in RECIPES.items()]
    assert len(set(prints)) == len(prints)


def test_records_are_of_the_recipes_as_they_are_now() -> None:
    for name, row in recorded().items():
        assert row["recipe"] == RECIPES.get(name).fingerprint, f"{name}: build it anew"
        assert row["steps"] >= RECIPES.get(name).source.steps


def test_a_fingerprint_counts_every_setting() -> None:
    recipe = RECIPES.get("tray-noisy")
    source = recipe.source
    changed = (
        replace(source, seed=1),
        replace(source, steps=20_001),
        replace(source, task="Tray-hard-v0"),
        replace(source, engine="bullet"),
        replace(source, settings={**source.settings, "noise": 0.11}),
    )
    prints = {replace(recipe, source=other).fingerprint for other in changed}
    assert len(prints) == len(changed) and recipe.fingerprint not in prints


def test_a_build_is_what_is_on_record_or_says_what_differs(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build_dataset(SMALL).verdict == "not on record yet"
    put(small)
    assert main(["datasets", "build", SMALL, "--workers", "1"]) == 0
    assert "the dataset on record, to the bit" in capsys.readouterr().out
    put(small, data_sha256="0" * 64)
    assert main(["datasets", "build", SMALL, "--workers", "1"]) == 1
    told = capsys.readouterr()
    assert "data_sha256 differ; that was made with python" in told.out
    assert f"not as on record: {SMALL}" in told.err


@pytest.mark.slow
def test_cards_are_rebuilt_to_the_bit_by_any_number_of_workers(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = build_dataset(SMALL).dataset
    card = data.location.folder / "card.json"  # which build has kept
    assert main(["datasets", "rebuild", str(card), "--workers", "1"]) == 0
    assert "the same data, SHA-256" in capsys.readouterr().out
    for what in ("marl_mm/small/noisy-v0", str(data.location.folder)):
        assert rebuild(what)[0] == data.metadata["marl_mm"]["data_sha256"]
    for workers in (1, 2):
        expected, actual = rebuild(card, workers=workers)
        assert expected == actual == data.metadata["marl_mm"]["data_sha256"]
    values = json.loads(card.read_text())
    values["made_of"]["seed"] += 1
    other = tmp_path / "other.json"
    other.write_text(json.dumps(values))
    assert main(["datasets", "rebuild", str(other), "--workers", "1"]) == 1
    error = capsys.readouterr().err
    assert "differ: none, so that code, processor or card is another" in error


@pytest.mark.usefixtures("datasets_home")
def test_a_study_takes_the_datasets_that_ship() -> None:
    sources = {row["id"]: RECIPES.get(row["name"]).source for row in catalogue_rows()}
    named = [sources[name] for name in IDS if name in sources]
    messages: list[str] = []
    for source in named:
        assert Datasets(notify=messages.append).get(source).location.id == source.name
    assert len(named) == 3 and not messages


def test_a_card_names_the_agent_that_acted(datasets_home: Path, tmp_path: Path) -> None:
    few: dict[str, Any] = {"steps": 20, "max_steps": 8, "engine": "mujoco"}
    data = marl_mm.collect("pretrained", dataset="marl_mm/reach/few-v0", **few)
    card = keep_card(data)
    assert card["made_of"]["weights"] == data.provenance.weights
    assert rebuild("few") == (card["data_sha256"],) * 2
    card["made_of"]["weights"] = "0" * 64
    other = tmp_path / "card.json"
    other.write_text(json.dumps(card))
    with pytest.raises(DatasetError, match=r"with weights 0000.*, here"):
        rebuild(other)


def test_what_cannot_be_built_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["datasets", "build", "tray-noisi"]) == 2
    assert "did you mean tray-noisy?" in capsys.readouterr().err
    assert main(["datasets", "build"]) == 2
    assert "name a recipe: quiet-zone-expert" in capsys.readouterr().err
    shipped = marl_mm.load_dataset("good-5k")
    keep_card(shipped)
    with pytest.raises((DatasetError, UsageError), match="only collected datasets"):
        rebuild(_without(shipped.location.folder / "card.json", tmp_path, "made_of"))
    with pytest.raises(DatasetError, match="lacks seed in made_of"):
        rebuild(_without(shipped.location.folder / "card.json", tmp_path, "seed"))


def test_the_catalogue_names_each_dataset_and_shows_cards(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["datasets", "catalogue"]) == 0
    table = capsys.readouterr().out
    for name, recipe in RECIPES.items():
        assert f" {name} " in table and f" {recipe.source.task} " in table
    assert main(["datasets", "catalogue", "bar-noisy"]) == 0
    card = capsys.readouterr().out
    row = recorded()["bar-noisy"]
    assert f"data sha256 {row['data_sha256']}\n" in card
    assert "noise 0.06, noise_memory 0.8, any_convention True" in card
    assert "marl-mm datasets build bar-noisy" in card
    assert main(["datasets", "catalogue", "bar-noisy", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [recipes.named_card("bar-noisy")]
    assert main(["datasets", "catalogue", "bar-noisi"]) == 2
    assert "did you mean bar-noisy?" in capsys.readouterr().err


@pytest.mark.slow
def test_names_of_recipes_are_names_of_datasets(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ids = {name: recipe.source.name for name, recipe in RECIPES.items()}
    assert named_ids() == ids and list(map(name_of, ids.values())) == list(ids)
    assert name_of("marl_mm/reach/pd-v0") is None
    data = marl_mm.load_dataset("quiet-zone-noisy")  # ships
    assert data.metadata["dataset_id"] == "marl_mm/quiet-zone/noisy-v0"
    for command in (
        ["datasets", "show", "tray-noisy"],
        ["datasets", "show", "marl_mm/tray/noisy-v0"],
        ["train", "mabc", "--dataset", "tray-noisy", "--out", str(tmp_path / "run")],
        ["datasets", "mix", "tray-noisy:20", "--out", "mixed"],
    ):
        assert main(command) > 0
        assert (
            f"no dataset marl_mm/tray/noisy-v0 below {datasets_home}: make it with "
            "marl-mm datasets build tray-noisy\n" in capsys.readouterr().err
        )


def _without(card: Path, folder: Path, name: str) -> Path:
    values = json.loads(card.read_text())
    values.pop(name, None)
    made_of = values.get("made_of") or dict.fromkeys(
        ("task", "collector", "collector_config", "overrides", "steps")
    )
    made_of.pop(name, None)
    path = folder / "card.json"
    path.write_text(
        json.dumps(values | ({"made_of": made_of} if name == "seed" else {}))
    )
    return path
