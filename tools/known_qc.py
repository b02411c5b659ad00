"""FQL, its flow, and Q-chunking as the authors of Q-chunking wrote them, on a file.

Their repository is https://github.com/ColinQiyangLi/qc, commit 48283b4 (MIT); nothing
of it is here. ``known_numbers.py`` says in which environment it runs.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from marl_mm.eval.bench.d3rlpy_reference import BATCH, DISCOUNT, HIDDEN, RATE, episodes

CHUNKS = {"flow-bc": 1, "fql": 1, "q-chunking": 3}
"""Actions in a row by algorithm, by our names."""

DISTILLATION, FLOW_STEPS = 10.0, 10
"""Weight of the distance to the flow's actions, and its steps: of both."""

Act = Callable[[np.ndarray], np.ndarray]
"""Function of an observation that returns the action."""

REPLACED = {
    "utils.networks": ("activations: Any = nn.gelu", "activations: Any = nn.relu"),
    "acfql": (
        "q_loss = -q.mean()",
        "q_loss = -q.mean() / jax.lax.stop_gradient(jnp.abs(q).mean())",
    ),
}
"""A line of each of two modules and what it is here: networks are of ReLU, as ours, and
the value is divided by its mean size, as we do and FQL's authors may. Q-chunking's do
not, and weigh the distance to the flow by 10 to 1,000 by task."""


def matched_agent(repository: Path) -> ModuleType:
    """Their agent, with the two lines replaced."""
    paths = "utils/networks.py", "agents/acfql.py"
    for path, (name, (line, other)) in zip(paths, REPLACED.items(), strict=True):
        source = (repository / path).read_text("utf-8")
        assert source.count(line) == 1, path
        module = sys.modules[name] = ModuleType(name)
        exec(compile(source.replace(line, other), path, "exec"), module.__dict__)
    return module


def train(
    repository: Path, path: Path, name: str, seed: int, updates: int
) -> Callable[[int], Act]:
    """Train one of theirs; returns a function that begins an episode, by its number."""
    sys.path.insert(0, str(repository))
    import jax
    import jax.numpy as jnp
    from utils.datasets import Dataset

    theirs, chunk = matched_agent(repository), CHUNKS[name]
    config = theirs.get_config()
    config.update(
        {
            **{"lr": RATE, "batch_size": BATCH, "discount": DISCOUNT},
            **{"actor_hidden_dims": HIDDEN, "value_hidden_dims": HIDDEN},
            **{"layer_norm": False, "alpha": DISTILLATION, "flow_steps": FLOW_STEPS},
            **{"horizon_length": chunk, "action_chunking": True},
        }
    )
    parts = episodes(path)
    data = {key: np.concatenate([each[key] for each in parts]) for key in parts[0]}
    mean, deviation = data["observation"].mean(axis=0), data["observation"].std(axis=0)

    def scaled(observation: np.ndarray) -> np.ndarray:
        return (observation - mean) / deviation

    dataset = Dataset.create(
        observations=scaled(data["observation"]),
        next_observations=scaled(data["next_observation"]),
        actions=data["action"],
        rewards=data["reward"],
        terminals=data["ended"].astype(np.float32),
        masks=1.0 - data["terminated"].astype(np.float32),
    )
    np.random.seed(seed)  # noqa: NPY002, which their batches are drawn by
    first = dataset["observations"][0], dataset["actions"][0]
    agent = theirs.ACFQLAgent.create(seed, *first, config)
    for _ in range(updates):
        agent, _ = agent.update(dataset.sample_sequence(BATCH, chunk, DISCOUNT))
    width = data["action"].shape[1]

    def begin(number: int) -> Act:
        keys = iter(jax.random.split(jax.random.PRNGKey(number), 1_000))
        planned: list[np.ndarray] = []

        def act(observation: np.ndarray) -> np.ndarray:
            if not planned:
                seen, key = jnp.asarray(scaled(observation)), next(keys)
                if name == "flow-bc":
                    noise = jax.random.normal(key, (width,))
                    action: Any = agent.compute_flow_actions(seen, noise)
                else:
                    action = agent.sample_actions(seen, key)
                planned.extend(np.asarray(action).reshape(chunk, width))
            return planned.pop(0)

        return act

    return begin
