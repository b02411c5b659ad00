"""Checkpoints from strangers: refused before torch builds what they ask for.

Each test is an attack that once worked.
"""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from marl_mm.algorithms import pretrained
from marl_mm.algorithms.actors import blank_actor
from marl_mm.algorithms.checkpoint import FILE, check_types, read_checkpoint
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.archives import PICKLE_BYTES, check_saved
from marl_mm.envs.registry import make_task
from marl_mm.errors import CheckpointError, UsageError

REACH = make_task("Reach-v0").layout


@pytest.fixture
def gift(tmp_path: Path) -> Path:
    """A checkpoint that somebody sent."""
    agents = [blank_actor(agent, (4,)) for agent in REACH.agents]
    contents = {
        "format": "marl_mm checkpoint 2",
        "algorithm": "td3-bc",
        "config": {},
        "layout": REACH.to_json(),
        "state": {"actors": {a.layout.name: a.actor.state_dict() for a in agents}},
    }
    torch.save(contents, tmp_path / FILE)
    load_policy(tmp_path)
    return tmp_path / FILE


def repack(
    path: Path, structure: bytes | None, compression: int = zipfile.ZIP_STORED
) -> None:
    """Write an archive anew, with another structure."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in parts.items():
            new = structure if name.endswith("data.pkl") else None
            archive.writestr(name, new or content)


def doubled(levels: int) -> bytes:
    """Structure of a tuple within tuples, each twice, as a key: its hash never ends."""
    inner = b"h\x00h\x00\x86q\x00" * levels
    return b"\x80\x02}q\x01)q\x00" + inner + b"h\x01h\x00K\x01s."


@pytest.mark.parametrize(
    ("structure", "match"),
    [
        (b"\x80\x02(" + b"}" * 30_000_000 + b"l.", "expected at most 250,000"),
        (b"\x80\x02](" + b"K\x01" * 10_000_000 + b"e.", "expected at most 250,000"),
        (doubled(60), "more than 3,000,000 values"),
    ],
    ids=["dicts", "numbers", "tuples"],
)
def test_structures_that_burst_are_refused(
    gift: Path, structure: bytes, match: str
) -> None:
    repack(gift, structure)
    with pytest.raises(CheckpointError, match=match):
        load_policy(gift)


def test_compressed_parts_are_refused(gift: Path) -> None:
    repack(gift, None, zipfile.ZIP_DEFLATED)
    with pytest.raises(CheckpointError, match="is compressed"):
        load_policy(gift)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_parts_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.pt"
    with zipfile.ZipFile(path, "w") as archive:
        for content in (b"\x80\x02K\x01.", b"\x80\x02K\x02."):
            archive.writestr("a/data.pkl", content)
    with pytest.raises(ValueError, match="two parts of one name"):
        check_saved(path)


@pytest.mark.parametrize("name", ["a/data.pkl", "a/DATA.PKL", "Data.pkl"])
def test_a_structure_is_looked_at_whatever_the_case_of_its_name(
    name: str, tmp_path: Path
) -> None:
    """torch finds it in any."""
    path = tmp_path / "structure.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, b"\x80\x04N.")
    with pytest.raises(ValueError, match="a pickle of protocol 4"):
        check_saved(path)


def test_an_archive_behind_another_file_is_refused(gift: Path) -> None:
    """torch would read what is before it, in its former format."""
    gift.write_bytes(b"\x80\x02." + gift.read_bytes())
    with pytest.raises(CheckpointError, match="does not begin as a zip archive"):
        load_policy(gift)


def test_archives_of_very_many_parts_are_refused(gift: Path) -> None:
    with zipfile.ZipFile(gift, "a") as archive:
        for number in range(6_000):
            archive.writestr(f"x/{number}", b"")
    with pytest.raises(CheckpointError, match="expected at most 5,000"):
        load_policy(gift)


def test_structures_have_room(gift: Path) -> None:
    """Ten times the largest of the built-in algorithms', 22,000 bytes."""
    contents = torch.load(gift, weights_only=True)
    contents["config"] = {f"key {number}": [number] * 5 for number in range(5_500)}
    torch.save(contents, gift)
    with zipfile.ZipFile(gift) as archive:
        size = archive.getinfo("checkpoint/data.pkl").file_size
    assert 200_000 < size < PICKLE_BYTES
    load_policy(gift)


def first_weight(contents: dict[str, Any], kind: torch.dtype) -> None:
    actor = next(iter(contents["state"]["actors"].values()))
    actor["layers.0.weight"] = actor["layers.0.weight"].to(kind)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: first_weight(c, torch.complex64), "type torch.complex64"),
        (lambda c: first_weight(c, torch.float16), "type torch.float16, expected"),
        (lambda c: first_weight(c, torch.int64), "type torch.int64, expected"),
        (lambda c: c.update(algorithm="<b>[red]x"), "algorithm is '<b>"),
    ],
    ids=["complex", "half", "int", "markup"],
)
def test_weights_and_names_of_other_kinds_are_refused(
    gift: Path, change: Callable[[dict[str, Any]], object], match: str
) -> None:
    contents = torch.load(gift, weights_only=True)
    change(contents)
    torch.save(contents, gift)
    with pytest.raises(CheckpointError, match=match.replace("[", r"\[")):
        load_policy(gift)


def test_tensors_of_other_types_are_found_in_lists_too() -> None:
    states = {"seeds": [{"critic": torch.ones(2)}, {"critic": torch.ones(2)}]}
    check_types(states, states)
    other = {"seeds": [states["seeds"][0], {"critic": torch.ones(2).double()}]}
    with pytest.raises(ValueError, match=r"critic has torch.float64, expected"):
        check_types(other, states)


def test_deep_actors_are_read_back_from_a_submission(tmp_path: Path) -> None:
    """Files have layers.10 before layers.2."""
    agents = {agent.name: blank_actor(agent, (4, 5) * 6) for agent in REACH.agents}
    states = {name: agent.actor.state_dict() for name, agent in agents.items()}
    checkpoint = {"state": {"actors": states}, "layout": REACH}
    pretrained.write_actors(tmp_path, checkpoint, {"algorithm": "mabc"})
    policy = load_policy(tmp_path)
    assert policy.name == "mabc"
    for name, state in states.items():
        check_types(policy.agents[name].actor.state_dict(), state)


def test_observations_of_other_shapes_are_refused() -> None:
    agents = {agent.name: blank_actor(agent, (4,)) for agent in REACH.agents}
    policy = LearnedPolicy("mabc", agents, REACH)
    goal_env = {"observation": np.zeros(7), "desired_goal": np.zeros(1)}
    with pytest.raises(UsageError, match=r"desired_goal has shape \(1,\), expec"):
        policy.act(goal_env)
    with pytest.raises(UsageError, match="observation has shape"):
        policy.act({"desired_goal": np.zeros(3)})
    with pytest.raises(UsageError, match="no agent 'hand', expected end_effector, bal"):
        policy.act_agents({"hand": np.zeros(9)})
    with pytest.raises(UsageError, match=r"of balance has shape \(3,\), expected"):
        policy.act_agents({"balance": np.zeros(3)})


def test_the_shipped_agent_is_known_by_any_path_to_it() -> None:
    for folder in (pretrained.FOLDER, pretrained.FOLDER.resolve()):
        assert load_policy(folder).name == "pretrained"


def test_shipped_policies_with_huge_records_are_refused(tmp_path: Path) -> None:
    config = (pretrained.FOLDER / "config.json").read_text()
    (tmp_path / "config.json").write_text(config)
    names = {
        f"a/{n}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
        for n in range(20_000)
    }
    header = json.dumps(names).encode()
    path = tmp_path / pretrained.WEIGHTS
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    with pytest.raises(CheckpointError, match="has a header of"):
        load_policy(tmp_path)
    (tmp_path / "config.json").write_text(config + " " * 1_000_000)
    with pytest.raises(CheckpointError, match="expected at most 1,000,000"):
        load_policy(tmp_path)


def test_no_run_goes_on_from_a_link_out_of_its_folder(gift: Path) -> None:
    run = gift.parent / "run"
    run.mkdir()
    (run / FILE).symlink_to(gift)
    with pytest.raises(CheckpointError, match="is a link out of its folder"):
        read_checkpoint(run)
