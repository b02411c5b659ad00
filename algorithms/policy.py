"""Learned policies: a checkpoint's actors behind the interface of every policy."""

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, restored_agents
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.layout import JOINT_NAME, Layout
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.received import refuse_links_out


class LearnedPolicy:
    """Actors, each on its own observation.

    Args:
        name: Name in tables.
        agents: Actors by agent.
        layout: Layout that they were trained for.
        source: Path that it was loaded from.
    """

    def __init__(
        self,
        name: str,
        agents: Mapping[str, AgentActor],
        layout: Layout,
        source: str | None = None,
    ) -> None:
        self.name = name
        self.agents = dict(agents)
        self.layout = layout
        self._source = source
        self._rng = np.random.default_rng(0)
        self._plans: dict[str, list[np.ndarray]] = {}

    def __repr__(self) -> str:
        return f"<LearnedPolicy {self.name}: {self._source}>"

    def describe(self) -> dict[str, Any]:
        """Path that it was loaded from."""
        return {"checkpoint": self._source}

    @cached_property
    def fingerprint(self) -> str:
        """Hash of all weights, which identifies the policy wherever its file is."""
        digest = hashlib.sha256()
        for agent in self.agents.values():
            for name, tensor in agent.actor.state_dict().items():
                digest.update(name.encode() + tensor.numpy().tobytes())
        return digest.hexdigest()[:16]

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Begin an episode.

        Raises:
            LayoutError: If the policy was trained for another layout.
        """
        joint = JOINT_NAME in self.agents
        refuse_other_layout(self.name, self.layout, "the task", layout, not joint)
        self._rng, self._plans = rng, {}

    def act(self, observation: np.ndarray | Mapping[str, np.ndarray]) -> np.ndarray:
        """Joint action, shape (k,), float32.

        Call ``begin`` before the first step of every episode: a policy that plans or
        draws noise goes on with its plan, and needs a stream of random numbers.

        Args:
            observation: Joint state, shape (n,), or the goal environment's dictionary.

        Raises:
            UsageError: If the state has another shape.
        """
        state = joint_state(observation, self.layout)
        action = np.empty(len(self.layout.action), np.float32)
        for agent in self.agents.values():
            layout = agent.layout
            observation = state[list(layout.observation)]
            action[list(layout.action)] = self._next(agent, observation)
        return action

    def _next(self, agent: AgentActor, observation: np.ndarray) -> np.ndarray:
        """An agent's next action, by its last plan as long as there is some left."""
        name, width = agent.layout.name, agent.actor.noise
        plan: Sequence[np.ndarray] = self._plans.get(name, ())
        if not plan:
            noise = self._rng.standard_normal(width, np.float32) if width else None
            plan = [*agent.plan(observation, noise)]
        action, *self._plans[name] = plan
        return action

    def act_agents(
        self, observations: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Each agent's action at its own observation, as PettingZoo wants them.

        Raises:
            UsageError: If one joint actor sees and sets everything, there is no such
                agent, or an observation has another shape.
        """
        if JOINT_NAME in self.agents:
            raise UsageError(
                f"{self.name} has one joint actor, which needs the joint state: step "
                "the parallel environment with marl_mm.envs.parallel.split_action of "
                "policy.act of its state(), and its layout"
            )
        own = self.agents
        for name, observation in observations.items():
            if name not in own:
                raise UsageError(
                    f"{self.name} has no agent {name!r}, expected {', '.join(own)}"
                )
            width = len(own[name].layout.observation)
            _check_shape(f"observation of {name}", observation, width)
        return {name: self._next(own[name], o) for name, o in observations.items()}


def joint_state(
    observation: np.ndarray | Mapping[str, np.ndarray], layout: Layout
) -> np.ndarray:
    """Joint state, shape (n,), from either form of observation."""
    if isinstance(observation, Mapping):
        goal = len(layout.desired)
        widths = {"observation": len(layout.state) - goal, "desired_goal": goal}
        for name, width in widths.items():
            _check_shape(name, observation.get(name), width)
        return layout.state_of(*(np.asarray(observation[name]) for name in widths))
    state = np.asarray(observation)
    layout.check_state(state)
    return state


def _check_shape(name: str, value: Any, width: int) -> None:
    if np.shape(value) != (width,):
        raise UsageError(f"{name} has shape {np.shape(value)}, expected ({width},)")


def load_policy(path: str | Path) -> LearnedPolicy:
    """The policy of a run folder or a checkpoint file.

    A run folder's is its last one; its best one is in ``best.pt``. ``"pretrained"`` and
    its folder mean the agent that ships.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If it is damaged, or a link out of the run folder.
    """
    from marl_mm.algorithms import pretrained  # which knows policies

    path = Path(path)
    if str(path) == pretrained.NAME and not path.exists():
        return pretrained.load_pretrained()
    if path.is_dir():
        names = (FILE, pretrained.WEIGHTS, "config.json")
        refuse_links_out(path, names, CheckpointError)
    if (path / pretrained.WEIGHTS).exists():
        return pretrained.load_pretrained(path)
    checkpoint = read_checkpoint(path)
    agents = restored_agents(checkpoint, path)
    return LearnedPolicy(
        checkpoint["algorithm"], agents, checkpoint["layout"], str(path)
    )
