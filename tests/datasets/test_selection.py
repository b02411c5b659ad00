"""Datasets of datasets: what is drawn, and that everybody can tell where it is from."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of, joined
from marl_mm.datasets.card import card, card_text
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.selection import (
    Condition,
    Part,
    filtered,
    mix,
    split,
    write_selection,
)
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.runs import deriving
from marl_mm.runs.sources import Source

MakeEpisode = Callable[..., Episode]


def about(name: str, **changes: Any) -> Provenance:
    """Of a collection; changes replace fields, or those of its origin."""
    origins = changes.pop("origins", {name: Origin(task="Reach-v0", seed=0)})
    ours = {"task": "Reach-v0", "overrides": {"max_steps": 25}, "seed": 0}
    return Provenance(collector="pd", origins=origins, **{**ours, **changes})


@pytest.fixture
def make(datasets_home: Path, make_episode: MakeEpisode) -> Callable[..., Dataset]:
    def write(name: str, first: int = 0, count: int = 10, **changes: object) -> Dataset:
        episodes = [
            make_episode(i, steps=2 + i % 4, success=i % 3 > 0)
            for i in range(first, first + count)
        ]
        location = locate(f"marl_mm/reach/{name}-v0")
        arrays = arrays_of(episodes, location.id)
        write_dataset(location, arrays, about(location.id, **changes))
        return load_dataset(location)

    return write


def test_selecting_and_joining_by_hand(make_episode: MakeEpisode) -> None:
    episodes = [make_episode(i, steps=2 + i) for i in range(5)]
    arrays = arrays_of(episodes, "x")
    chosen = arrays.select([3, 0])
    assert chosen.lengths.tolist() == [5, 2]
    both = joined([chosen, arrays.select([4])])
    for number, original in enumerate((3, 0, 4)):
        joint, own = both.episode(number), episodes[original]
        assert joint.states.tobytes() == own.states.tobytes()
        assert joint.actions.tobytes() == own.actions.tobytes()
        assert joint.info["d_mm"].tobytes() == own.info["d_mm"].tobytes()
        assert (joint.seed, joint.index) == (own.seed, own.index)
    assert both.origin_episodes.tolist() == [3, 0, 4]
    np.testing.assert_allclose(both.returns()[1], episodes[0].rewards.sum())


def test_a_mix_has_its_steps_and_says_whose_they_are(
    make: Callable[..., Dataset],
) -> None:
    first, second = make("one"), make("two", first=50)
    recipe = mix([Part(first, 10), Part(second, 7)], seed=0)
    write_selection(locate("marl_mm/reach/mix-v0"), recipe)
    mixed = load_dataset("mix")
    arrays = mixed.arrays
    for part, steps in ((first, 10), (second, 7)):
        mine = arrays.origins == part.metadata["dataset_id"]
        lengths = arrays.lengths[mine]
        assert lengths.sum() >= steps > lengths.sum() - lengths.max()
        for number in np.flatnonzero(mine):
            source = part.arrays.episode(int(arrays.origin_episodes[number]))
            assert (
                source.states.tobytes() == arrays.episode(int(number)).states.tobytes()
            )
    assert len(mixed.metadata["marl_mm"]["origins"]) == 2
    assert mixed.metadata["marl_mm"]["recipe"]["steps"] == {
        "marl_mm/reach/one-v0": 10,
        "marl_mm/reach/two-v0": 7,
    }


def test_numbers_of_numpy_are_as_good(make: Callable[..., Dataset]) -> None:
    three: Any = np.int64(3)
    recipe = mix([Part(make("pd"), three)], three)
    write_selection(locate("marl_mm/reach/mine-v0"), recipe)
    told = load_dataset("mine").provenance.recipe
    assert told is not None and told["seed"] == 3
    assert Source(steps=three, seed=three) == Source(steps=3, seed=3)


def test_the_engines_version_comes_along_where_it_is_one(
    make: Callable[..., Dataset],
) -> None:
    one = make("one", packages={"pybullet": "3.2.7"})
    for first, version, text in (
        (20, "3.2.7", "bullet 3.2.7"),
        (40, "3.2.6", "bullet"),
    ):
        other = make(f"from-{first}", first, packages={"pybullet": version})
        recipe = mix([Part(one, 10), Part(other, 10)], seed=0)
        write_selection(locate(f"mix-{first}"), recipe)
        mixed = load_dataset(f"mix-{first}")
        assert card(mixed)["engine"] == text
        write_selection(
            locate(f"ahead-{first}"), filtered(mixed, Condition(success=True))
        )
        assert card(load_dataset(f"ahead-{first}"))["engine"] == text


def test_a_mix_depends_on_its_seed_alone(make: Callable[..., Dataset]) -> None:
    parts = [Part(make("one"), 10)]
    same = [mix(parts, seed=1).arrays.origin_episodes.tolist() for _ in range(2)]
    assert same[0] == same[1]
    others = [mix(parts, seed=s).arrays.origin_episodes.tolist() for s in range(5)]
    assert len(set(map(tuple, others))) > 1


def test_provenance_survives_two_generations(make: Callable[..., Dataset]) -> None:
    write_selection(locate("marl_mm/reach/a-v0"), mix([Part(make("one"), 20)], seed=0))
    first, _ = split(load_dataset("a"), 0.5, seed=0)
    assert set(first.arrays.origins) == {"marl_mm/reach/one-v0"}
    assert set(first.provenance.origins) == {"marl_mm/reach/one-v0"}


def test_a_split_divides_without_loss(make: Callable[..., Dataset]) -> None:
    dataset = make("one")
    first, rest = split(dataset, 0.3, seed=5)
    assert (len(first.arrays), len(rest.arrays)) == (3, 7)
    numbers = [*first.arrays.origin_episodes, *rest.arrays.origin_episodes]
    assert sorted(numbers) == list(range(10))


def test_a_stopped_split_leaves_no_half_of_another(
    make: Callable[..., Dataset], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = make("one")
    first, rest = marl_mm.split_dataset(one, share=0.3)

    def stopped(location: Location, *given: Any) -> None:
        if location == rest.location:
            raise KeyboardInterrupt
        write_selection(location, *given)

    monkeypatch.setattr(deriving, "write_selection", stopped)
    with pytest.raises(KeyboardInterrupt):
        marl_mm.split_dataset(one, share=0.3, seed=1, overwrite=True)
    assert first.location.folder.exists() and not rest.location.folder.exists()


def test_no_dataset_is_replaced_by_what_is_made_of_it(
    make: Callable[..., Dataset],
) -> None:
    one = make("one")
    before, out = one.fingerprint, one.location.folder
    with pytest.raises(UsageError, match="choose another"):
        marl_mm.filter_dataset(one, out, outcome="reached", overwrite=True)
    with pytest.raises(UsageError, match="choose another"):
        marl_mm.mix_datasets([(make("two", 20), 5), (one, 5)], out, overwrite=True)
    assert load_dataset("one").fingerprint == before


def test_what_python_makes_has_its_card_beside_it(
    make: Callable[..., Dataset],
) -> None:
    few = marl_mm.filter_dataset(make("one"), "few", outcome="reached")
    kept = json.loads((few.location.folder / "card.json").read_text())
    assert kept["episodes"] == len(few.arrays)


def test_a_split_that_is_refused_deletes_nothing(make: Callable[..., Dataset]) -> None:
    one = make("one")
    first, rest = marl_mm.split_dataset(one, share=0.3)
    first.location.working.mkdir()
    (first.location.working / "episodes.sqlite").touch()
    with pytest.raises(UsageError, match="a collection was begun"):
        marl_mm.split_dataset(one, share=0.3, seed=1, overwrite=True)
    assert first.location.folder.exists() and rest.location.folder.exists()


@pytest.mark.parametrize(
    ("condition", "keeps"),
    [
        (Condition(success=True), lambda e: e.success),
        (Condition(success=False), lambda e: not e.success),
        (Condition(direction="forward"), lambda e: e.direction == "forward"),
        (Condition(direction="backward"), lambda e: e.direction == "backward"),
        (Condition(min_return=0.0), lambda e: e.episode_return >= 0),
        (
            Condition(success=True, max_return=0.5),
            lambda e: e.success and e.episode_return <= 0.5,
        ),
    ],
)
def test_a_filter_keeps_what_it_says(
    make: Callable[..., Dataset],
    condition: Condition,
    keeps: Callable[[Episode], bool],
) -> None:
    dataset = make("one")
    expected = [i for i, e in enumerate(dataset.episodes) if keeps(e)]
    assert filtered(dataset, condition).arrays.origin_episodes.tolist() == expected


def test_recipes_refuse_what_makes_no_sense(make: Callable[..., Dataset]) -> None:
    reach, other = make("one"), make("other", task="SmoothReach-v0")
    with pytest.raises(UsageError, match="asked for 10000"):
        mix([Part(reach, 10_000)], seed=0)
    with pytest.raises(UsageError, match="each dataset once"):
        mix([Part(reach, 2), Part(reach, 2)], seed=0)
    with pytest.raises(UsageError, match="their rewards differ"):
        mix([Part(reach, 2), Part(other, 2)], seed=0)
    with pytest.raises(UsageError, match="between 0 and 1"):
        split(reach, 1.0, seed=0)
    with pytest.raises(UsageError, match="none of the 10 episodes"):
        filtered(reach, Condition(min_return=1e9))
    with pytest.raises(UsageError, match="no condition"):
        filtered(reach, Condition())
    impostor = make("two", origins={"marl_mm/reach/one-v0": Origin(seed=7)})
    with pytest.raises(UsageError, match="two different datasets are called"):
        mix([Part(reach, 2), Part(impostor, 2)], seed=0)


def test_no_episode_is_in_a_mix_twice(
    make: Callable[..., Dataset], tmp_path: Path
) -> None:
    """As of two collections of one seed, or of a dataset and its copy."""
    short, long = make("short", count=5), make("long", count=20)
    with pytest.raises(UsageError, match="hold the same episodes"):
        mix([Part(short, short.arrays.steps), Part(long, long.arrays.steps)], seed=0)
    acted = replace(short.arrays, sources=np.array(["somebody"] * 5))
    other = Dataset(long.location, long.metadata, acted)
    mix([Part(short, 2), Part(other, 2)], seed=0)  # random and medium begin alike
    copy = shutil.copytree(short.location.folder, tmp_path / "copy")
    with pytest.raises(UsageError, match="are both called marl_mm/reach/short-v0"):
        mix([Part(short, 2), Part(load_dataset(copy), 2)], seed=0)


def test_a_part_with_shorter_names_is_as_it_should_be(
    make: Callable[..., Dataset],
) -> None:
    short_name, long_name = make("one"), make("a-much-longer-name", first=50)
    write_selection(
        locate("both"), mix([Part(short_name, 10), Part(long_name, 10)], seed=0)
    )
    both = load_dataset("both")
    short = both.arrays.select(
        np.flatnonzero(both.arrays.origins == short_name.location.id)
    )
    write_dataset(locate("short"), short, replace(both.provenance, recipe=None))
    assert not [p for p in verify(locate("short")) if "is not what the data" in p]


def test_the_card_tells_the_recipe(make: Callable[..., Dataset]) -> None:
    location = locate("ahead")
    write_selection(location, filtered(make("one"), Condition(direction="forward")))
    text = card_text(card(load_dataset(location)))
    assert "condition (direction: forward)" in text
    assert "forward 60 % of 5" in text
    assert "backward" not in text


def test_views_of_arrays_are_views(make_episode: MakeEpisode) -> None:
    arrays: EpisodeArrays = arrays_of([make_episode(i) for i in range(3)], "x")
    assert np.shares_memory(arrays.episode(1).states, arrays.states)
    assert arrays.is_last_state().sum() == arrays.is_first_state().sum() == 3


def test_a_mix_is_as_complete_and_as_long_as_its_parts_allow(
    make: Callable[..., Dataset],
) -> None:
    """Stopped if one was; steps of an episode as in the one with the longest."""
    one, two = make("one"), make("two", 20)
    assert mix([Part(one, 5), Part(two, 5)], seed=0).provenance.complete
    stopped = make("three", 40, complete=False, overrides={"max_steps": 50})
    for parts in ((one, stopped), (stopped, two)):
        mixed = mix([Part(part, 5) for part in parts], seed=0).provenance
        assert not mixed.complete and mixed.overrides["max_steps"] == 50


def test_the_options_of_commands_stand_in_the_recipe(
    make: Callable[..., Dataset],
) -> None:
    name = make("one").location.name
    bounds = {"min_return": -99.0, "max_return": 99.0}
    asked = [
        *("--outcome", "reached", "--direction", "forward"),
        *("--min-return", "-99", "--max-return", "99"),
    ]
    cut = ["split", name, "--out", "cut", "--share", "0.3", "--seed", "4"]
    assert main(["datasets", *cut]) == 0
    assert main(["datasets", "mix", f"{name}:9", "--out", "some", "--seed", "4"]) == 0
    assert main(["datasets", "filter", name, "--out", "few", *asked]) == 0
    recipes = [
        load_dataset(out).provenance.recipe for out in ("cut-first-v0", "some", "few")
    ]
    assert recipes == [
        {"kind": "split", "seed": 4, "share": 0.3, "part": "first"},
        {"kind": "mix", "seed": 4, "steps": {"marl_mm/reach/one-v0": 9}},
        {
            "kind": "filter",
            "condition": {"success": True, "direction": "forward", **bounds},
        },
    ]
