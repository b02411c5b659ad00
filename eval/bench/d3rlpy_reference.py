"""d3rlpy's algorithms, to time ours against and to compare what they learn.

d3rlpy wants an environment of its own (Python 3.11; d3rlpy==2.8.1, torch==2.13.0,
numpy==2.4.6), so this file imports nothing of ours. There

    python d3rlpy_reference.py FILE.npz

makes all algorithms for a file of transitions, reads lines of an algorithm, a number
of threads and one of updates, and answers each with updates per second.
"""

import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

NAMES = ("bc", "td3-bc", "iql", "rebrac", "cql")
"""Those that both have and that are timed, by our names."""

RATE, DISCOUNT, HIDDEN, BATCH = 3e-4, 0.99, (256, 256), 256
Q_WEIGHT, EXPECTILE, TEMPERATURE = 2.5, 0.7, 3.0
ACTOR_PENALTY, CRITIC_PENALTY = 0.05, 0.01
CONSERVATISM, SAMPLES = 5.0, 3
"""Settings of ours that are compared."""


def episodes(path: Path) -> list[dict[str, np.ndarray]]:
    """Episodes of a file of transitions; a last one that did not end is left out."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    ends = np.flatnonzero(arrays["ended"]) + 1
    parts = {name: np.split(array, ends)[:-1] for name, array in arrays.items()}
    return [
        {name: part[number] for name, part in parts.items()}
        for number in range(len(ends))
    ]


def algorithm(name: str) -> Any:
    """One of theirs, with networks and settings of ours that are compared."""
    import d3rlpy
    from d3rlpy.models.encoders import VectorEncoderFactory
    from d3rlpy.preprocessing import StandardObservationScaler

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
    held_down: dict[str, Any] = {
        **{"conservative_weight": CONSERVATISM, "n_action_samples": SAMPLES},
        **{"initial_alpha": 1.0, "alpha_learning_rate": 0},
    }
    algos = d3rlpy.algos
    configs: dict[str, Any] = {
        "bc": lambda: algos.BCConfig(learning_rate=RATE, encoder_factory=net, **shared),
        "td3-bc": lambda: algos.TD3PlusBCConfig(alpha=Q_WEIGHT, **pair, **shared),
        "iql": lambda: algos.IQLConfig(
            value_encoder_factory=net,
            expectile=EXPECTILE,
            weight_temp=TEMPERATURE,
            **pair,
            **shared,
        ),
        "rebrac": lambda: algos.ReBRACConfig(
            actor_beta=ACTOR_PENALTY, critic_beta=CRITIC_PENALTY, **pair, **shared
        ),
        "cql": lambda: algos.CQLConfig(**held_down, **pair, **shared),
        "cal-ql": lambda: algos.CalQLConfig(**held_down, **pair, **shared),
    }
    return configs[name]().create(device="cpu:0")


def replay(path: Path) -> Any:
    """A file's episodes, as d3rlpy keeps them."""
    from d3rlpy.dataset import Episode, create_infinite_replay_buffer

    return create_infinite_replay_buffer(
        [
            Episode(
                e["observation"],
                e["action"],
                e["reward"][:, None],
                terminated=bool(e["terminated"][-1]),
            )
            for e in episodes(path)
        ]
    )


def serve(path: Path) -> None:
    """Time updates as standard input asks, until it ends."""
    import torch

    answers, sys.stdout = sys.stdout, sys.stderr  # where d3rlpy's log goes then
    data, made = replay(path), {name: algorithm(name) for name in NAMES}
    for each in made.values():
        each.build_with_dataset(data)
        each.observation_scaler.fit_with_transition_picker(
            data.episodes, data.transition_picker
        )
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        name, threads, updates = line.split()
        torch.set_num_threads(int(threads))
        begin = perf_counter()
        for _ in range(int(updates)):
            made[name].update(data.sample_transition_batch(BATCH))
        answers.write(f"{int(updates) / (perf_counter() - begin)}\n")
        answers.flush()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
