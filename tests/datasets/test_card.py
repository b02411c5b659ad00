"""A dataset's card in notebooks: complete, and safe against the names of strangers."""

import base64
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import marl_mm
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.card import LATER, card, keep_card
from marl_mm.datasets.card_figure import draw_card
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.episode import Episode

pytestmark = pytest.mark.usefixtures("drawn")
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def shipped(datasets_home: Path) -> Dataset:
    return load_dataset(SHIPPED)


def test_a_notebook_shows_numbers_and_figure(shipped: Dataset) -> None:
    assert shipped.card() == card(shipped)
    page = shipped._repr_html_()
    rows = dict(re.findall("<tr><td>(.*?)</td><td>(.*?)</td></tr>", page))
    assert rows["id"] == SHIPPED
    assert rows["steps"] == str(shipped.arrays.steps)
    assert rows["coverage"]
    (picture,) = re.findall('src="data:image/png;base64,([^"]+)"', page)
    assert base64.b64decode(picture, validate=True).startswith(PNG)


def test_returns_that_differ_in_their_last_bits_have_a_histogram(
    datasets_home: Path, make_episode: Callable[..., Episode]
) -> None:
    episodes = [make_episode(number, steps=3) for number in range(2)]
    episodes[0].rewards[:] = 0.1, 0.1, 1.0
    episodes[1].rewards[:] = 1.0, 0.1, 0.1
    name = "marl_mm/reach/test-v0"
    about = Provenance(task="Reach-v0", collector="pd")
    write_dataset(locate(name), arrays_of(episodes, name), about)
    dataset = load_dataset(name)
    histogram = dataset.card()["return_histogram"]
    assert sum(histogram["counts"]) == 2 and histogram["low"] < 1.2 < histogram["high"]
    draw_card(dataset.arrays, dataset.card(), locate(name).folder / "card.png")
    assert (locate(name).folder / "card.png").read_bytes().startswith(PNG)


def _stopped(*given: object) -> None:
    raise KeyboardInterrupt


def test_a_card_whose_page_was_not_written_is_written_again(
    shipped: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shipped.location.folder
    for name in ("card.md", "card.png"):
        (folder / name).write_text("of another")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("marl_mm.datasets.card.write_card", _stopped)
        keep_card(shipped)
    keep_card(shipped)
    assert (folder / "card.md").read_text() != "of another"


@pytest.mark.slow
def test_names_of_strangers_are_text(shipped: Dataset, tmp_path: Path) -> None:
    name = "<script>alert(1)</script>$\\frac{$"
    shipped.metadata["dataset_id"] = name
    shipped.metadata["marl_mm"]["collector"] = "<img src=x onerror=alert(1)>"
    page = shipped._repr_html_()
    assert "&lt;script&gt;alert(1)&lt;/script&gt;$\\frac{$" in page
    assert page.count("<img") == 1 and "<script" not in page
    goal = next(e for e in shipped.arrays.layout.state if e.name == "goal_x")
    odd = replace(goal, unit="$\\frac$")
    state = tuple(odd if e is goal else e for e in shipped.arrays.layout.state)
    arrays = replace(shipped.arrays, layout=replace(shipped.arrays.layout, state=state))
    draw_card(arrays, shipped.card(), tmp_path / "card.png")
    assert (tmp_path / "card.png").read_bytes().startswith(PNG)


@pytest.mark.slow
def test_cards_of_version_1_are_well_and_forged_ones_are_not(tmp_path: Path) -> None:
    data = marl_mm.collect("random", dataset=tmp_path / "mine", steps=30)
    path = data.location.folder / "card.json"
    kept = json.loads(path.read_text())
    old = {key: value for key, value in kept.items() if key not in LATER}
    path.write_text(json.dumps(old))
    assert verify(data.location) == []
    path.write_text(json.dumps(kept | {"data_sha256": "0" * 64}))
    assert "is of other data" in verify(data.location)[0]
