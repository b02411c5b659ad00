"""What an attacker may change in a submission, and what has to be said of it."""

import json
import pickle
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from marl_mm.algorithms.pretrained import WEIGHTS
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.errors import MarlMmError
from marl_mm.files import write_json
from marl_mm.received import file_digest
from marl_mm.runs.folder import CONFIG, EVALUATION
from marl_mm.runs.submission import (
    EPISODES,
    MANIFEST,
    described,
    files_of,
    read_run,
    seal,
)

Change = Callable[[Path], None]
"""Change of a submission's folder."""


def edit(path: Path, change: Callable[[Any], Any]) -> None:
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


def row(number: int, **values: Any) -> Change:
    return lambda folder: edit(
        folder / "0" / EVALUATION, lambda v: v["episodes"][number].update(values)
    )


def in_each(name: str, change: Callable[[Any], Any]) -> Change:
    def tamper(folder: Path) -> None:
        for seed in "01":
            edit(folder / seed / name, change)

    return tamper


def manifest(change: Callable[[Any], Any]) -> Change:
    return lambda folder: edit(folder / MANIFEST, change)


def weights(
    change: Callable[[torch.Tensor], torch.Tensor], last: bool = True, seed: str = "0"
) -> Change:
    """Change weights of a seed, and their hash in its record."""

    def tamper(folder: Path) -> None:
        path = folder / seed / WEIGHTS
        tensors = load_file(path)
        names = [name for name in tensors if name.endswith("4.bias") or not last]
        changed = {
            n: change(tensors[n]) for n in names if tensors[n].is_floating_point()
        }
        save_file(tensors | changed, path)
        own_hash(folder, seed)

    return tamper


def own_hash(folder: Path, seed: str = "0") -> None:
    digest = file_digest(folder / seed / WEIGHTS, MarlMmError)
    edit(folder / seed / CONFIG, lambda v: v.update(weights_sha256=digest))


def swapped(folder: Path) -> None:
    """Weights of each seed in the other's folder, with their records."""
    for name in (WEIGHTS, CONFIG):
        one, other = folder / "0" / name, folder / "1" / name
        kept = one.read_bytes()
        one.write_bytes(other.read_bytes())
        other.write_bytes(kept)
    edit(folder / "0" / CONFIG, lambda v: v.update(seed=0))
    edit(folder / "1" / CONFIG, lambda v: v.update(seed=1))


def twice(folder: Path) -> None:
    shutil.rmtree(folder / "1")
    shutil.copytree(folder / "0", folder / "1")
    edit(folder / "1" / CONFIG, lambda v: v.update(seed=1))


def removed(values: Any, number: int = 2) -> None:
    for part in (values.get(k) for k in ("episodes", "sha256", "first_action")):
        if part:
            del part[number]


def without_row(folder: Path) -> None:
    for name in (EVALUATION, EPISODES):
        edit(folder / "0" / name, removed)
        edit(folder / "1" / name, removed)


def invented(folder: Path) -> None:
    """Every goal of seed 0 reached, soon; hashes of nothing."""
    for name in "01":
        edit(
            folder / name / EVALUATION,
            lambda v: [
                r.update({"success": True, "return": r["return"] + 20})
                for r in v["episodes"]
            ],
        )
        edit(
            folder / name / EPISODES,
            lambda v: v.update(sha256=["0" * 64 for _ in v["sha256"]]),
        )


def huge(folder: Path) -> None:
    """One return beyond all bounds, which widens an interval of differences, too."""
    in_each(EPISODES, lambda v: v.update(sha256=["0" * 64 for _ in v["sha256"]]))(
        folder
    )
    row(0, **{"return": 1e6})(folder)


def without_distance(values: Any) -> None:
    for each in values["episodes"]:
        del each["final_distance"]


def exchanged(folder: Path) -> None:
    """Outcomes of all goals the other way round; hashes of nothing."""
    invented(folder)
    in_each(
        EVALUATION,
        lambda v: [
            r.update({"success": not number % 2, "return": r["return"] - 20})
            for number, r in enumerate(v["episodes"])
        ],
    )(folder)


def linked(folder: Path) -> None:
    path = folder / "0" / WEIGHTS
    outside = path.rename(folder.parent / "outside.safetensors")
    path.symlink_to(outside)


def linked_seed(folder: Path) -> None:
    outside = (folder / "0").rename(folder.parent / "outside")
    (folder / "0").symlink_to(outside)


def pickled(folder: Path) -> None:
    (folder / "0" / "extra.pkl").write_bytes(pickle.dumps({"a": 1}))


def pickle_for_weights(folder: Path) -> None:
    torch.save({"a": torch.zeros(3)}, folder / "0" / WEIGHTS)
    own_hash(folder)


def truncated(folder: Path) -> None:
    path = folder / "0" / WEIGHTS
    path.write_bytes(path.read_bytes()[:-40])
    own_hash(folder)


def hash_of_another(values: Any) -> None:
    values["sha256"][1] = values["sha256"][0]


def looser(values: Any) -> None:
    values["overrides"]["success_distance"] = 0.5


def elsewhere(folder: Path) -> None:
    """A goal that nobody has; hashes of nothing."""
    in_each(EPISODES, lambda v: v.update(sha256=["0" * 64 for _ in v["sha256"]]))(
        folder
    )
    row(1, goal=[9.0, 9.0, 9.0])(folder)


def slippery(values: Any) -> None:
    values["overrides"]["simulation"]["wheel_friction"] = 0.5


def longer(values: Any) -> None:
    values["overrides"]["max_steps"] = 40


def other_recipe(values: Any) -> None:
    recipe = {"recipe": "quiet-zone-noisy", "recipe_sha256": "0" * 64}
    values["dataset"] |= recipe


TAMPERING: dict[str, tuple[Change, str]] = {
    "a weight changed": (weights(lambda v: v + 0.5), "did not make these rows"),
    "weights of another seed": (swapped, "did not make these rows"),
    "one seed twice": (twice, "has the weights of"),
    "a thousand columns": (
        row(0, **{f"column {number}": 1.0 for number in range(1_000)}),
        "columns, expected at most 1,000",
    ),
    "a NaN weight": (weights(lambda v: v * np.nan), "NaN or infinite"),
    "a weight's type": (weights(lambda v: v.double()), "float64, expected"),
    "a weight's shape": (weights(lambda v: v[:-1].clone()), "is damaged"),
    "weights cut off": (truncated, "is damaged"),
    "a pickle for weights": (pickle_for_weights, "is damaged"),
    "a link for weights": (linked, "no links"),
    "a link for a seed's folder": (linked_seed, "holds '0'.*no links"),
    "a file added": (pickled, "holds '0/extra.pkl'"),
    "an empty folder added": (
        lambda folder: (folder / "extra").mkdir(),
        "holds 'extra'",
    ),
    "a path out of the folder": (
        manifest(lambda v: v["files"].update({"../x": "0" * 64})),
        "'../x' is not the manifest's file",
    ),
    "a success flipped": (row(0, success=False), "rows of goals 0 do not follow"),
    "a return raised": (row(3, **{"return": 99.0}), "do not follow.*by return"),
    "a row removed": (without_row, "row 2 is not of goal 2"),
    "a row twice": (
        in_each(EVALUATION, lambda v: v["episodes"].__setitem__(1, v["episodes"][0])),
        "row 1 is not of goal 1",
    ),
    "another goal": (elsewhere, "goals 1, or goals, are others"),
    "an episode's hash copied": (
        lambda folder: edit(folder / "0" / EPISODES, hash_of_another),
        "episodes of goals 1 are others",
    ),
    "all rows invented": (invented, "return: claimed"),
    "a huge return": (huge, "return: claimed"),
    "a number left out": (
        in_each(EVALUATION, without_distance),
        "do not follow.*by final_distance",
    ),
    "outcomes exchanged": (exchanged, "goals have another outcome than is claimed"),
    "a first action": (
        in_each(EPISODES, lambda v: v["first_action"].__setitem__(1, [9.0])),
        "goals 1 do not follow.*by first action",
    ),
    "a version of the engine": (
        in_each(EVALUATION, lambda v: v.update(engine_version="9.9 (verified)")),
        "9.9 .verified.', the manifest has",
    ),
    "a recipe without its hash": (
        in_each(CONFIG, lambda v: v["dataset"].update(recipe="quiet-zone-noisy")),
        "quiet-zone-noisy is another",
    ),
    "the goals' seed": (
        in_each(EVALUATION, lambda v: v.update(seed=1)),
        "goal 0 of se",
    ),
    "a looser task": (in_each(EVALUATION, looser), "replaces success_distance"),
    "another simulation": (in_each(EVALUATION, slippery), "replaces wheel_friction"),
    "an engine that is none": (
        in_each(
            EVALUATION, lambda v: v.update(overrides={"simulation": {"engine": 1}})
        ),
        "simulation.engine is 1",
    ),
    "endless episodes": (
        in_each(EVALUATION, lambda v: v["overrides"].update(max_steps=10**9)),
        "at most 250",
    ),
    "more steps": (in_each(EVALUATION, longer), "are others, while"),
    "another task": (
        in_each(EVALUATION, lambda v: v.update(task="Gate-v0")),
        "same setting",
    ),
    "another engine of the runs": (
        in_each(CONFIG, lambda v: v.update(engine="bullet")),
        "same setting",
    ),
    "other steps of a seed": (
        lambda folder: edit(
            folder / "1" / EVALUATION, lambda v: v["overrides"].update(max_steps=24)
        ),
        "1: its rows are not of the same setting",
    ),
    "another layout": (
        in_each(CONFIG, lambda v: v["layout"]["state"][0].__setitem__(3, 9.0)),
        "another layout than the task",
    ),
    "a seed's hyper-parameter": (
        lambda folder: edit(folder / "0" / CONFIG, lambda v: v.update(batch_size=9)),
        "another setting",
    ),
    "a formula for a name": (
        in_each(CONFIG, lambda v: v.update(algorithm="=1+1")),
        "algorithm is '=1.1', expected at most 200",
    ),
    "a formula behind a name": (
        in_each(
            CONFIG,
            lambda v: v.update(
                algorithm="=1+1", dataset=v["dataset"] | {"algorithm": "bc"}
            ),
        ),
        "algorithm is '=1.1', expected at most 200",
    ),
    "a page for a name": (
        in_each(CONFIG, lambda v: v["dataset"].update(id="a" * 10_000)),
        "id is 'a+, expected at most 200",
    ),
    "another recipe": (in_each(CONFIG, other_recipe), "quiet-zone-noisy is another"),
    "no seeds": (manifest(lambda v: v.update(seeds=[])), "expected 1 to 100"),
    "a seed below 0": (
        manifest(lambda v: v.update(seeds=[-1])),
        "has the seed -1, expected >= 0",
    ),
    "no claims": (manifest(lambda v: v.pop("claims")), "claims"),
    "a number in the manifest": (manifest(lambda v: v.update(rank=1)), "has 'rank'"),
    "a rate beside the rows": (
        in_each(EVALUATION, lambda v: v.update(success_rate=1.0)),
        "has 'success_rate', which nobody checks",
    ),
    "another engine's name": (
        in_each(EVALUATION, lambda v: v.update(engine="bullet 1.0")),
        "engine is 'bullet 1.0', expected",
    ),
    "settings of the policy": (
        in_each(EVALUATION, lambda v: v.update(policy_config={"noise": 0.0})),
        "policy_config is",
    ),
    "another policy's name": (
        in_each(EVALUATION, lambda v: v.update(policy="best")),
        "policy is 'best', expected",
    ),
}
"""What an attacker changes, and what is said of it though all hashes are recomputed."""

CLAIMS: dict[str, tuple[Change, str]] = {
    "a claim raised": (
        manifest(lambda v: v["claims"].update(success=1.5)),
        "claims that success is 1.5",
    ),
    "a claim more": (
        manifest(lambda v: v["claims"].update(transfer=0.9)),
        "claims 'transfer', which is not scored",
    ),
    "a claim raised a little": (
        manifest(lambda v: v["claims"].update(success=v["claims"]["success"] + 1e-3)),
        "claims that success is",
    ),
    "another format": (
        manifest(lambda v: v.update(format="marl_mm submission 2")),
        "is no 'marl_mm submission 1' file",
    ),
    "an interval narrowed": (
        manifest(lambda v: v["claims"].update(success_interval=[0.9, 0.91])),
        "claims that success_interval",
    ),
    "the algorithm's name": (manifest(lambda v: v.update(algorithm="mine")), "'mine'"),
    "the dataset": (
        manifest(lambda v: v["dataset"].update(id="marl_mm/reach/other-v0")),
        "other-v0",
    ),
    "the number of goals": (manifest(lambda v: v["goals"].update(count=900)), "900"),
    "a looser task in the manifest": (
        manifest(lambda v: v["task_config"].update(success_distance=0.5)),
        "success_distance = 0.5",
    ),
    "the engine": (manifest(lambda v: v.update(engine="mujoco 9.9")), "mujoco 9.9"),
}
"""The same for what follows from the seeds' files."""


UNSEALED: dict[str, tuple[Change, str]] = {
    "a version": (manifest(lambda v: v["packages"].update(numpy="1.0")), ""),
    "the machine": (manifest(lambda v: v["machine"].update(processor="Z80")), ""),
    "a seed's updates": (
        in_each(CONFIG, lambda v: v.update(updates=10**6)),
        "",
    ),
}
"""What is found as long as the hashes are not recomputed: no episode depends on it."""


def seal_again(folder: Path, claims: bool = True) -> None:
    """Recompute what an attacker can: claims from the rows, all hashes, fingerprint."""
    values = json.loads((folder / MANIFEST).read_text())
    with suppress(MarlMmError, IndexError):  # it may not even read back
        extra = {k: v for k, v in values["files"].items() if k.startswith("..")}
        values["files"] = files_of(folder, values["seeds"]) | extra
        runs = [read_run(folder / str(seed)) for seed in values["seeds"]]
        if claims and "claims" in values:
            task = make_task(runs[0].evaluation.task, runs[0].evaluation.overrides)
            values |= {**described(runs), "task_config": config_dict(task)}
    write_json(folder / MANIFEST, values | {"fingerprint": seal(values)})
