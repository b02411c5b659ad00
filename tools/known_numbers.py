"""Our single-agent algorithms and others' on the same file of a public task.

Hopper-v5 of Gymnasium, learnt by Stable-Baselines3's SAC; the file is its replay. In
our environment, with the extra "bench" and ``pip install glfw imageio``:

    python tools/known_numbers.py collect hopper.npz
    python tools/known_numbers.py about hopper.npz
    python tools/known_numbers.py ours hopper.npz

In an environment of its own (Python 3.11; d3rlpy==2.8.1, torch==2.13.0, numpy==2.4.6,
mujoco==3.3.0, glfw, imageio):

    PYTHONPATH=. python tools/known_numbers.py d3rlpy hopper.npz

And in another one (Python 3.11; jax==0.6.0, flax==0.10.5, distrax==0.1.5,
ml_collections==1.1.0, optax==0.2.4, numpy==2.2.5, gymnasium==1.1.1, mujoco==3.3.0,
glfw, imageio, matplotlib), beside a clone of ``known_qc.py``'s repository:

    PYTHONPATH=. python tools/known_numbers.py qc hopper.npz CLONE

All write eval/results/known.csv, a row per implementation, algorithm and seed. What is
there is not run again. All have the settings of ``marl_mm.eval.bench.matched`` and the
same number of updates; the last policy is evaluated.
"""

import csv
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from known_qc import CHUNKS, DISTILLATION, FLOW_STEPS, Act
from known_qc import train as theirs_of_qc

from marl_mm.eval.bench.d3rlpy_reference import NAMES, algorithm, episodes, replay

TASK = "Hopper-v5"
STEPS = 50_000
"""Steps of SAC, and of the file."""

OF_D3RLPY = *NAMES, "cal-ql"
"""Those that d3rlpy has, too."""

UPDATES = dict.fromkeys((*OF_D3RLPY, *CHUNKS), 10_000) | {"cql": 5_000}
"""Updates of each, in both; of CQL's fewer, as each takes five times as long. Cal-QL
has them all, as its values begin far below the returns that bound them."""

SEEDS, EPISODES = range(5), 10
FILE = Path(__file__).resolve().parents[1] / "eval/results/known.csv"

Begin = Callable[[int], Act]
"""Function of an episode's number, the seed of its noise, that returns the policy."""


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


def about(path: Path) -> str:
    """Number of the file's whole episodes, and their returns."""
    with np.load(path) as data:
        ends = np.flatnonzero(data["ended"]) + 1
        *whole, _ = np.split(data["reward"], ends)
    returns = [episode.sum() for episode in whole]
    mean, highest = np.mean(returns), max(returns)
    return f"{len(returns)} episodes, mean return {mean:.0f}, highest {highest:.0f}"


def mean_return(begin: Begin, seed: int) -> float:
    """Mean return of some episodes, whose starts are the same for all seeds.

    A policy's own noise is not: what it is worth by chance is in the intervals.
    """
    env, returns = gymnasium.make(TASK), []
    for number in range(EPISODES):
        observation, _ = env.reset(seed=1_000 + number)
        returns.append(0.0)
        act, ended = begin(EPISODES * seed + number), False
        while not ended:
            action = np.clip(act(observation.astype(np.float32)), -1, 1)
            observation, reward, terminated, truncated, _ = env.step(action)
            returns[-1] += float(reward)
            ended = terminated or truncated
    return float(np.mean(returns))


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


def ours(path: Path, name: str, seed: int) -> Begin:
    """Train one of ours."""
    from marl_mm.algorithms.policy import LearnedPolicy
    from marl_mm.algorithms.speed import small_networks
    from marl_mm.eval.bench.matched import learner, matched

    own = {
        "distillation": DISTILLATION,
        "flow_steps": FLOW_STEPS,
        "chunk": CHUNKS.get(name),
    }
    config = matched(name, updates=UPDATES[name], precision="highest", **own)
    arrays = our_arrays(path)
    with small_networks():
        made = learner(name, config, arrays, NoJudge(), seed)
        for _ in range(UPDATES[name]):
            made.update()
    policy = LearnedPolicy(name, made.agents(0), arrays.layout)

    def begin(number: int) -> Act:
        policy.begin(np.random.default_rng(number), arrays.layout)
        return policy.act

    return begin


def theirs(path: Path, name: str, seed: int) -> Begin:
    """Train one of d3rlpy's."""
    import d3rlpy
    import torch

    torch.set_num_threads(1)
    d3rlpy.seed(seed)
    made = algorithm(name)
    made.fit(
        replay(path),
        n_steps=UPDATES[name],
        n_steps_per_epoch=UPDATES[name],
        show_progress=False,
        save_interval=10**9,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )
    return lambda _: lambda observation: made.predict(observation[None])[0]


def of_qc(path: Path, name: str, seed: int) -> Begin:
    """Train one of Q-chunking's authors'."""
    return theirs_of_qc(Path(sys.argv[3]), path, name, seed, UPDATES[name])


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
    if what in ("collect", "about"):
        print(about(path))
        return
    train, names = {
        "ours": (ours, [*UPDATES]),
        "d3rlpy": (theirs, OF_D3RLPY),
        "qc": (of_qc, CHUNKS),
    }[what]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    for seed in SEEDS:
        for name in names:
            rows = kept()
            key = {"from": what, "algorithm": name, "seed": str(seed), "file": digest}
            if any(all(row[k] == v for k, v in key.items()) for row in rows):
                continue
            value = mean_return(train(path, name, seed), seed)
            print(key, value, flush=True)
            row = {**key, "return": f"{value:.1f}"}
            rows = kept()  # another process may have added some
            with FILE.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
                writer.writerows([*rows, row])


if __name__ == "__main__":
    main()
