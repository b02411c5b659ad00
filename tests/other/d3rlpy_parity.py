"""Whether our TD3+BC and d3rlpy's learn as much from the same data; by hand.

Both get the same normalised states and actions, batches of 256, two layers of 256, c,
rates and number of updates, and none of our additions; 200 goals, three seeds. d3rlpy
lives in an environment of its own, see ``d3rlpy_reads.py``::

    python tests/other/d3rlpy_parity.py data DATASET FOLDER
    d3/bin/python tests/other/d3rlpy_parity.py theirs FOLDER
    python tests/other/d3rlpy_parity.py ours FOLDER

Goals reached of 600, Wilson's 95 % interval, and every seed, on good-30k (d3rlpy 2.8.1,
torch 2.13, one thread each)::

    c = 2.5, ours: 0.0 % [0.0, 0.6] (0.0, 0.0, 0.0)
    c = 2.5, d3rlpy: 0.0 % [0.0, 0.6] (0.0, 0.0, 0.0)
    c = 0.5, ours: 43.2 % [39.3, 47.2] (41.5, 40.0, 48.0)
    c = 0.5, d3rlpy: 44.7 % [40.7, 48.7] (46.5, 44.0, 43.5)
"""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.layout import Layout

UPDATES = 10_000
WEIGHTS = (2.5, 0.5)
"""c; the authors' and one at which both learn to reach."""

SEEDS = (0, 1, 2)
GOALS = 200


def data(dataset: str, folder: Path) -> None:
    """What both learn from, as plain arrays."""
    from marl_mm.algorithms.replay import normalized_actions
    from marl_mm.datasets import load_dataset
    from marl_mm.eval.bench.offline import plain_config

    found = load_dataset(dataset)
    states = found.arrays.states.astype(np.float32)
    mean = states.mean(axis=0)
    std = states.std(axis=0).clip(plain_config().std_floor)
    joint = found.joint()
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(
        folder / "data.npz",
        observations=((joint.observation - mean) / std).astype(np.float32),
        actions=normalized_actions(joint.action, found.arrays.layout),
        rewards=joint.reward.astype(np.float32),
        terminals=joint.terminated,
        timeouts=joint.truncated,
        mean=mean,
        std=std,
    )
    config = asdict(plain_config()) | {"dataset": dataset}
    (folder / "config.json").write_text(json.dumps(config))


def theirs(folder: Path) -> None:
    """Train d3rlpy's, and save its policies."""
    import d3rlpy
    import torch
    from d3rlpy.dataset import MDPDataset

    torch.set_num_threads(1)
    arrays = np.load(folder / "data.npz")
    names = ("observations", "actions", "rewards")
    flat = MDPDataset(
        *(arrays[name] for name in names),
        terminals=arrays["terminals"],
        timeouts=arrays["timeouts"],
    )
    config = json.loads((folder / "config.json").read_text())
    encoder = d3rlpy.models.VectorEncoderFactory(config["hidden"])
    for c in WEIGHTS:
        for seed in SEEDS:
            d3rlpy.seed(seed)
            algorithm = d3rlpy.algos.TD3PlusBCConfig(
                actor_learning_rate=config["actor_learning_rate"],
                critic_learning_rate=config["critic_learning_rate"],
                actor_encoder_factory=encoder,
                critic_encoder_factory=encoder,
                batch_size=config["batch_size"],
                gamma=config["discount"],
                tau=config["target_rate"],
                target_smoothing_sigma=config["target_noise"],
                target_smoothing_clip=config["target_noise_clip"],
                update_actor_interval=config["policy_delay"],
                alpha=c,
            ).create(device="cpu")
            algorithm.fit(
                flat,
                n_steps=UPDATES,
                n_steps_per_epoch=UPDATES,
                show_progress=False,
                logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
            )
            algorithm.save_policy(str(folder / f"theirs-{c}-{seed}.pt"))


class TheirPolicy:
    """d3rlpy's policy behind our interface."""

    name = "d3rlpy"

    def __init__(self, path: Path, mean: np.ndarray, std: np.ndarray) -> None:
        self._path, self._mean, self._std = path, mean, std
        self._policy: Any = None  # loaded where it acts: it cannot be pickled

    def describe(self) -> dict[str, Any]:
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        self._layout = layout

    def act(self, state: np.ndarray) -> np.ndarray:
        import torch

        if self._policy is None:
            self._policy = torch.jit.load(self._path)  # type: ignore[no-untyped-call]
        inputs = ((state - self._mean) / self._std).astype(np.float32)[None]
        with torch.no_grad():
            action = self._policy(torch.from_numpy(inputs))[0].numpy()
        low, high = np.array(self._layout.low), np.array(self._layout.high)
        scaled = low + (action.clip(-1, 1) + 1) / 2 * (high - low)
        return np.asarray(scaled, np.float32)


def ours(folder: Path) -> None:
    """Train ours, evaluate both, and say what was reached."""
    import torch

    from marl_mm.algorithms.policy import LearnedPolicy
    from marl_mm.algorithms.speed import matrix_products
    from marl_mm.algorithms.td3_bc import Td3Bc
    from marl_mm.datasets import load_dataset
    from marl_mm.envs.registry import make_task
    from marl_mm.eval.bench.offline import plain_config
    from marl_mm.eval.evaluate import evaluate
    from marl_mm.eval.intervals import success_interval
    from marl_mm.policy import Policy

    torch.set_num_threads(1)
    dataset = json.loads((folder / "config.json").read_text())["dataset"]
    arrays = load_dataset(dataset).arrays
    known = np.load(folder / "data.npz")
    for c in WEIGHTS:
        config = replace(plain_config(), q_weight=c, updates=UPDATES)
        rates: dict[str, list[float]] = {"ours": [], "d3rlpy": []}
        for seed in SEEDS:
            algorithm = Td3Bc(config, arrays, make_task(), [seed])
            with matrix_products("auto"):  # as by default
                while algorithm.step < UPDATES:
                    algorithm.update()
            path = folder / f"theirs-{c}-{seed}.pt"
            policies: dict[str, Policy] = {
                "ours": LearnedPolicy("ours", algorithm.agents(0), algorithm.layout),
                "d3rlpy": TheirPolicy(path, known["mean"], known["std"]),
            }
            for name, policy in policies.items():
                rates[name].append(evaluate(policy, GOALS, workers=2).success_rate)
        for name, seeds in rates.items():
            low, high = success_interval(round(sum(seeds) * GOALS), len(seeds) * GOALS)
            by_seed = ", ".join(f"{100 * rate:.1f}" for rate in seeds)
            print(
                f"{dataset}, c = {c}, {name}: {100 * np.mean(seeds):.1f} % "
                f"[{100 * low:.1f}, {100 * high:.1f}] ({by_seed})",
                flush=True,
            )


if __name__ == "__main__":
    command, *words = sys.argv[1:]
    if command == "data":
        data(words[0], Path(words[1]))
    else:
        {"theirs": theirs, "ours": ours}[command](Path(words[0]))
