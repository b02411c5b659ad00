"""What goes wrong while learning from a dataset: told, and a policy is left."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import read_checkpoint
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc
from marl_mm.algorithms.matd3_bc_config import Matd3BcConfig
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import resolved
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.algorithms.train import train, update_to
from marl_mm.cli import main
from marl_mm.datasets import load_dataset
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.envs.registry import make_task
from marl_mm.episode import Episode
from marl_mm.errors import DivergedError, UsageError
from marl_mm.progress import Advance, silent_bar
from marl_mm.runs import learning, seeds
from marl_mm.runs.training import training_of

MakeEpisode = Callable[..., Episode]
JUDGE = make_task()
SMALL: dict[str, Any] = {"hidden": (16, 16), "batch_size": 32}
KINDS: tuple[tuple[Any, Any], ...] = (
    (Mabc, MabcConfig),
    (Td3Bc, Td3BcConfig),
    (Matd3Bc, Matd3BcConfig),
)
FEW: dict[str, Any] = {
    "eval_episodes": 2,
    "curve_episodes": 1,
    "curve_every": 200,
    "max_steps": 5,
}
WORDS = (
    "td3-bc --dataset good-5k --updates 200 --hidden 8 8 --batch-size 16 "
    "--curve-every 200 --curve-episodes 1 --eval-episodes 2 --max-steps 5"
).split()


@pytest.fixture
def arrays(make_episode: MakeEpisode) -> EpisodeArrays:
    return arrays_of([make_episode(i, 3 + i % 4, i % 3 > 0) for i in range(20)], "x")


def spoil_batches(algorithm: Any, monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """Let one number of the batch of an update be NaN."""
    draw = algorithm._batches.next

    def spoilt() -> Any:
        batch = draw()
        if algorithm.step == step - 1:
            batch.observation[0, 3, 2] = torch.nan
        return batch

    monkeypatch.setattr(algorithm._batches, "next", spoilt)


class Uncounted(Mabc):
    """Updates of it do not count."""

    def update(self) -> dict[str, torch.Tensor]:
        losses = super().update()
        self.step -= 1
        return losses


def test_updates_that_are_not_counted_come_to_an_end(arrays: EpisodeArrays) -> None:
    learner = Uncounted(MabcConfig(**SMALL), arrays, JUDGE, [0])
    with pytest.raises(UsageError, match="`step` of mabc is 0 after update 1"):
        update_to(learner, 3)


@pytest.mark.parametrize(("kind", "config"), KINDS)
@pytest.mark.parametrize(("step", "kept"), [(50, 0), (150, 100)])
def test_a_nan_in_a_batch_ends_the_run(
    arrays: EpisodeArrays,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: Any,
    config: Any,
    step: int,
    kept: int,
) -> None:
    """And leaves the checkpoint before, be it the first one."""
    algorithm = kind(config(updates=300, **SMALL), arrays, JUDGE, [0])
    spoil_batches(algorithm, monkeypatch, step)
    with pytest.raises(DivergedError, match=rf"is nan with .* of update {kept}$") as it:
        train(algorithm, [tmp_path], lambda policy: {}, 100)
    assert ("`clip_targets`" in str(it.value)) == (kind is not Mabc)
    assert read_checkpoint(tmp_path)["state"]["step"] == kept
    assert np.isfinite(load_policy(tmp_path).act(np.zeros(10))).all()


def spoilt_at_200(arrays: EpisodeArrays) -> tuple[Td3Bc, Advance]:
    """An algorithm, and what makes its critics' values run away half-way."""
    algorithm = Td3Bc(Td3BcConfig(updates=300, **SMALL), arrays, JUDGE, [0])

    def spoil(done: int, note: str) -> None:
        if algorithm.step == 200:
            with torch.no_grad():
                algorithm.critics.networks.flat.mul_(1e4)

    return algorithm, spoil


def test_a_value_beyond_all_returns_ends_the_run(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    """And weights that the last step spoilt are not kept."""
    algorithm, spoil = spoilt_at_200(arrays)
    with pytest.raises(DivergedError, match=r"q/data is .* more than .* update 200"):
        train(algorithm, [tmp_path], lambda policy: {}, 100, spoil)
    assert np.isfinite(load_policy(tmp_path).act(np.zeros(10))).all()


def test_no_value_is_too_large_where_no_reward_is_known(arrays: EpisodeArrays) -> None:
    """And own episodes count, after a restart too."""
    nothing = replace(arrays, rewards=np.zeros_like(arrays.rewards))
    config = Td3BcConfig(updates=300, **SMALL)
    algorithm, again = (Td3Bc(config, nothing, JUDGE, [0]) for _ in range(2))
    assert algorithm.bounds == {}
    algorithm.observe(arrays, 0.5)
    bounds = Td3Bc(config, arrays, JUDGE, [0]).bounds
    assert algorithm.bounds == bounds and bounds["q/data"] > 0
    again.load_states([algorithm.state(0)])
    assert again.bounds == bounds


def test_unless_it_is_to_go_on_to_its_end(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    algorithm, spoil = spoilt_at_200(arrays)
    train(algorithm, [tmp_path], lambda policy: {}, 100, spoil, stop_diverging=False)
    assert algorithm.step == 300
    rows = read_metrics(tmp_path)
    assert rows[-1]["q/largest"] > algorithm.bounds["q/largest"]


def test_weights_that_the_last_step_spoilt_are_not_kept(
    arrays: EpisodeArrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm = Td3Bc(Td3BcConfig(updates=300, **SMALL), arrays, JUDGE, [0])
    update = algorithm.update

    def spoilt() -> dict[str, torch.Tensor]:
        losses = update()
        if algorithm.step == 200:  # where a checkpoint would be
            algorithm.actors.networks["joint"].flat.fill_(torch.nan)
        return losses

    monkeypatch.setattr(algorithm, "update", spoilt)
    with pytest.raises(DivergedError, match=r"nan with seed 0 .* of update 100"):
        train(algorithm, [tmp_path], lambda policy: {}, 100)
    assert np.isfinite(load_policy(tmp_path).act(np.zeros(10))).all()


def test_a_critic_that_no_actor_follows_is_watched_too(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    """The second one of the second agent's pair."""
    config = Matd3BcConfig(updates=300, critics="own", **SMALL)
    algorithm = Matd3Bc(config, arrays, JUDGE, [0])

    def spoil(done: int, note: str) -> None:
        if algorithm.step == 200:
            with torch.no_grad():
                for weights in algorithm.critics.networks.weights.values():
                    weights[3].mul_(1e4)

    with pytest.raises(DivergedError, match=r"q/largest is .* more than .* update 200"):
        train(algorithm, [tmp_path], lambda policy: {}, 100, spoil)


def one_diverges(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Let this seed's training end with an error after its hundredth update."""

    def spoilt(algorithm: OfflineAlgorithm, *arguments: Any) -> None:
        diagnose = algorithm.diagnose

        def bad() -> dict[str, torch.Tensor]:
            found = diagnose()
            if algorithm.step > 100 and seed in algorithm.seeds:
                number = algorithm.seeds.index(seed)
                found["action/saturation"][number] = torch.inf
            return found

        monkeypatch.setattr(algorithm, "diagnose", bad)
        train(algorithm, *arguments)

    monkeypatch.setattr(learning, "train", spoilt)


@pytest.mark.slow
def test_seeds_side_by_side_outlive_one_that_diverges(
    datasets_home: Path, tmp_path: Path
) -> None:
    """As on a GPU, here on the CPU: the others go on alone to where they would come."""
    options: Any = training_of("td3-bc", workers=1, **FEW)
    small = replace(options.config, updates=200, hidden=(8, 8), batch_size=16)
    options = replace(options, config=small, resume=True)
    dataset = load_dataset("good-5k")

    def trained(name: str, diverges: int) -> tuple[list[Any], dict[int, Any]]:
        runs = {seed: tmp_path / name / str(seed) for seed in (0, 1, 2)}
        with pytest.MonkeyPatch.context() as patch:
            one_diverges(patch, diverges)
            learning.begin_runs(options, dataset, runs)
            parts = list(seeds._together(options, dataset, runs, silent_bar))
        return parts, {seed: read_checkpoint(run) for seed, run in runs.items()}

    (whole,), expected = trained("whole", diverges=9)
    assert len(whole) == 3
    (first, second, third), found = trained("cut", diverges=1)
    assert isinstance(second, DivergedError)
    assert f"{tmp_path}/cut/1: the checkpoint of update 100" in str(second)
    assert [run.name for run in (*first, *third)] == ["0", "2"]
    for seed, step in ((0, 200), (1, 100), (2, 200)):
        assert found[seed]["state"]["step"] == step
    for seed in (0, 2):
        pair = (one[seed]["state"]["actors"]["joint"] for one in (expected, found))
        for one, other in zip(*(actor.values() for actor in pair), strict=True):
            torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-3)


@pytest.mark.slow
def test_results_of_other_seeds_are_printed(
    datasets_home: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As JSON too, and what the run was made of says which arithmetic it was."""
    one_diverges(monkeypatch, 0)
    seeds = ["--seeds", "0", "1", "--workers", "1", "--out", str(tmp_path), "--json"]
    assert main(["train", *WORDS, *seeds]) == 1
    said = capsys.readouterr()
    (result,) = json.loads(said.out)
    assert result["run"] == str(tmp_path / "1")
    assert "the checkpoint of update 100" in said.err
    config = json.loads((tmp_path / "1" / "config.json").read_text())
    assert config["precision"] == resolved("auto")


def test_bounds_are_a_hundred_times_what_any_return_can_be(
    arrays: EpisodeArrays,
) -> None:
    """By 1 / (1 - discount); rewards below 0 count, too."""
    negative = replace(arrays, rewards=-np.abs(arrays.rewards))
    algorithm = Td3Bc(Td3BcConfig(discount=0.9, **SMALL), negative, JUDGE, [0])
    bound = pytest.approx(100 * np.abs(arrays.rewards).max() / 0.1)
    names = "q/data", "q/policy", "q/largest"
    assert algorithm.bounds == dict.fromkeys(names, bound)
