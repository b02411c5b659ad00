"""Our single-agent algorithms and d3rlpy's on the same file of a public task.

Hopper-v5 of Gymnasium, learnt by Stable-Baselines3's SAC; the file is its replay. In
our environment, with the extra "bench" and ``pip install glfw imageio``:

    python tools/known_numbers.py collect hopper.npz
    python tools/known_numbers.py ours hopper.npz

In an environment of its own (Python 3.11; d3rlpy==2.8.1, torch==2.13.0, numpy==2.4.6,
mujoco==3.3.0, glfw, imageio):

    python tools/known_numbers.py d3rlpy hopper.npz

Both write eval/results/known.csv, a row per implementation, algorithm and seed. What is
there is not run again. Both have the same networks, rates, batches and number of
updates; the last policy is evaluated. What stays different: d3rlpy's actors of IQL and
CQL are Gaussian, that of CQL is SAC's, ours give one action and CQL's is TD3's.
"""

import csv
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

TASK = "Hopper-v5"
STEPS = 50_000
"""Steps of SAC, and of the file."""

UPDATES, SEEDS, EPISODES = 10_000, range(5), 10
RATE, DISCOUNT, HIDDEN, BATCH = 3e-4, 0.99, (256, 256), 256
FILE = Path(__file__).resolve().parents[1] / "eval/results/known.csv"

SHARED: dict[str, Any] = {
    "updates": UPDATES,
    "batch_size": BATCH,
    "hidden": HIDDEN,
    "discount": DISCOUNT,
    "future": 0.0,
    "elsewhere": 0.0,
    "clip_targets": False,
    "layer_norm": False,
}
OURS: dict[str, dict[str, Any]] = {
    "bc": {"learning_rate": RATE},
    "td3-bc": {
        **{"actor_learning_rate": RATE, "critic_learning_rate": RATE},
        **{"q_weight": 2.5, "imitate": "all", "imitation_scaled": False},
    },
    "iql": {"learning_rate": RATE, "expectile": 0.7, "temperature": 3.0},
    "rebrac": {"learning_rate": RATE, "actor_weight": 0.05, "critic_weight": 0.01},
    "cql": {
        **{"learning_rate": RATE, "conservatism": 5.0, "samples": 10},
        "penalized": BATCH,
    },
}
"""Hyper-parameters of ours beside those that all share."""

Act = Callable[[np.ndarray], np.ndarray]


def collect(path: Path) -> None:
    """Let SAC learn, and write its replay."""
    from stable_baselines3 import SAC

    sac = SAC("MlpPolicy", TASK, seed=0, device="cpu", buffer_size=STEPS)
    sac.learn(STEPS, progress_bar=True)
    replay = sac.replay_buffer
    assert replay is not None
    np.savez_compressed(
        path,
        observation=replay.observations[:, 0].astype(np.float32),
        next_observation=replay.next_observations[:, 0].astype(np.float32),
        action=replay.actions[:, 0].astype(np.float32),
        reward=replay.rewards[:, 0].astype(np.float32),
        terminated=replay.dones[:, 0] * (1 - replay.timeouts[:, 0]) > 0,
        ended=replay.dones[:, 0] > 0,
    )


def episodes(path: Path) -> list[dict[str, np.ndarray]]:
    """Episodes of the file; the last one, which is not finished, is left out."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    ends = np.flatnonzero(arrays["ended"]) + 1
    parts = {name: np.split(array, ends)[:-1] for name, array in arrays.items()}
    return [
        {name: part[number] for name, part in parts.items()}
        for number in range(len(ends))
    ]


def mean_return(act: Act) -> float:
    """Mean return of some episodes, the same for all."""
    env, returns = gymnasium.make(TASK), []
    for number in range(EPISODES):
        observation, _ = env.reset(seed=1_000 + number)
        returns.append(0.0)
        ended = False
        while not ended:
            action = np.clip(act(observation.astype(np.float32)), -1, 1)
            observation, reward, terminated, truncated, _ = env.step(action)
            returns[-1] += float(reward)
            ended = terminated or truncated
    return float(np.mean(returns))


# --- Ours --------------------------------------------------------------------


def our_arrays(path: Path) -> Any:
    """The file's episodes, of one agent that sees and sets everything."""
    from marl_mm.datasets.arrays import arrays_of
    from marl_mm.episode import Episode
    from marl_mm.layout import Agent, Entry, Layout

    listed = episodes(path)
    width, count = (listed[0][name].shape[1] for name in ("observation", "action"))
    state = tuple(Entry(f"s_{i}", "1") for i in range(width))
    action = tuple(Entry(f"a_{i}", "1", -1.0, 1.0) for i in range(count))
    names = tuple(entry.name for entry in state)
    agent = Agent("robot", names, tuple(entry.name for entry in action))
    layout = Layout(state, action, (agent,), names[:1], names[1:2])
    return arrays_of(
        [
            Episode(
                states=np.concatenate([e["observation"], e["next_observation"][-1:]]),
                actions=e["action"],
                rewards=e["reward"].astype(float),
                terminated=e["terminated"],
                truncated=e["ended"] & ~e["terminated"],
                info={"is_success": np.zeros(len(e["reward"]))},
                layout=layout,
                seed=number,
                index=number,
                source="sac",
                start=np.zeros(11),
            )
            for number, e in enumerate(listed)
        ],
        "hopper",
    )


class NoJudge:
    """Goals are never exchanged."""

    highest_return = None
    needs: tuple[str, ...] = ()

    def judge(self, achieved: np.ndarray, *_: Any) -> tuple[np.ndarray, np.ndarray]:
        """Rewards of no steps."""
        return np.zeros(len(achieved)), np.zeros(len(achieved), bool)


def ours(path: Path, name: str, seed: int) -> Act:
    """Train one of ours."""
    from dataclasses import fields, replace

    from marl_mm.algorithms.registry import ALGORITHMS, preset
    from marl_mm.algorithms.speed import prepare_for_small_networks

    prepare_for_small_networks()
    default = preset(name)
    known = {field.name for field in fields(default)}
    settings = {key: value for key, value in SHARED.items() if key in known}
    config = replace(default, **settings | OURS[name], precision="highest")
    learner = ALGORITHMS.get(name).learner(
        config, our_arrays(path), NoJudge(), [seed], "cpu"
    )
    for _ in range(UPDATES):
        learner.update()
    (agent,) = learner.agents(0).values()
    return lambda observation: agent.plan(observation)[0]


# --- d3rlpy's ----------------------------------------------------------------


def theirs(path: Path, name: str, seed: int) -> Act:
    """Train one of d3rlpy's."""
    import d3rlpy
    from d3rlpy.models.encoders import VectorEncoderFactory
    from d3rlpy.preprocessing import StandardObservationScaler

    torch.set_num_threads(1)
    d3rlpy.seed(seed)
    net = VectorEncoderFactory([*HIDDEN])
    shared: dict[str, Any] = {
        "batch_size": BATCH,
        "gamma": DISCOUNT,
        "observation_scaler": StandardObservationScaler(),
    }
    pair: dict[str, Any] = {
        **{"actor_learning_rate": RATE, "critic_learning_rate": RATE},
        **{"actor_encoder_factory": net, "critic_encoder_factory": net},
    }
    algos = d3rlpy.algos
    configs: dict[str, Any] = {
        "bc": lambda: algos.BCConfig(learning_rate=RATE, encoder_factory=net, **shared),
        "td3-bc": lambda: algos.TD3PlusBCConfig(alpha=2.5, **pair, **shared),
        "iql": lambda: algos.IQLConfig(value_encoder_factory=net, **pair, **shared),
        "rebrac": lambda: algos.ReBRACConfig(
            actor_beta=0.05, critic_beta=0.01, **pair, **shared
        ),
        "cql": lambda: algos.CQLConfig(
            conservative_weight=5.0,
            initial_alpha=1.0,
            alpha_learning_rate=0,
            **pair,
            **shared,
        ),
    }
    data = d3rlpy.dataset.create_infinite_replay_buffer(
        [
            d3rlpy.dataset.Episode(
                e["observation"],
                e["action"],
                e["reward"][:, None],
                terminated=bool(e["terminated"][-1]),
            )
            for e in episodes(path)
        ]
    )
    algorithm = configs[name]().create(device="cpu:0")
    algorithm.fit(
        data,
        n_steps=UPDATES,
        n_steps_per_epoch=UPDATES,
        show_progress=False,
        save_interval=10**9,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )
    return lambda observation: algorithm.predict(observation[None])[0]


# --- Rows --------------------------------------------------------------------


def kept() -> list[dict[str, str]]:
    """Rows that are there."""
    if not FILE.exists():
        return []
    with FILE.open(newline="") as file:
        return list(csv.DictReader(file))


def main() -> None:
    """Make the file, or the rows that are missing."""
    what, path = sys.argv[1], Path(sys.argv[2])
    if what == "collect":
        collect(path)
        return
    train = {"ours": ours, "d3rlpy": theirs}[what]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    for seed in SEEDS:
        for name in OURS:
            rows = kept()
            key = {"from": what, "algorithm": name, "seed": str(seed), "file": digest}
            if any(all(row[k] == v for k, v in key.items()) for row in rows):
                continue
            value = mean_return(train(path, name, seed))
            print(key, value, flush=True)
            row = {**key, "return": f"{value:.1f}"}
            rows = kept()  # another process may have added some
            with FILE.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
                writer.writerows([*rows, row])


if __name__ == "__main__":
    main()
