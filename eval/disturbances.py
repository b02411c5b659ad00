"""Policies of which one agent is late, loses views, freezes, sees noise, or is another.

Of a team only the disturbed agent is shown another view. A joint actor has one view for
all it does: in it the entries that the agent would see are changed. So both meet the
same numbers. They are drawn from the episode's seed, and not by the policy's own
stream.
"""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.layout import JOINT_NAME, AgentLayout, Layout
from marl_mm.policy import Policy


class Disturbed:
    """A policy of which one agent is disturbed.

    Args:
        policy: Policy that acts.
        agent: Agent of the task's layout, whose entries are changed.
        strength: Strength of the disturbance, in its unit.
        spread: Spread of each entry of the joint state, shape (n,), in its unit.
    """

    def __init__(
        self,
        policy: Policy,
        agent: AgentLayout,
        strength: float,
        spread: np.ndarray,
    ) -> None:
        self._policy, self._agent, self._strength = policy, agent, strength
        self._sees, self._sets = list(agent.observation), list(agent.action)
        self._spread = spread[self._sees]
        self.name = f"{policy.name}, {self._about}"

    @property
    def _about(self) -> str:
        return f"{type(self).__name__.lower()} {self._agent.name} {self._strength:g}"

    def describe(self) -> dict[str, Any]:
        """The disturbance, and the policy's own settings."""
        return {"disturbed": self._about, **self._policy.describe()}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Begin an episode of the policy, and a stream of the disturbance's own."""
        self._policy.begin(rng, layout)
        (self._rng,) = rng.spawn(1)  # which leaves the policy's numbers as they are
        self._past: list[np.ndarray] = []

    def act(self, state: np.ndarray) -> np.ndarray:
        """The joint action, by what the agent is shown and does."""
        seen = state.copy()
        seen[self._sees] = self._shown(state[self._sees])
        action = np.array(self._policy.act(seen))
        action[self._sets] = self._done(action[self._sets])
        return action

    def _shown(self, view: np.ndarray) -> np.ndarray:
        """What the agent sees in place of its view."""
        return view

    def _done(self, action: np.ndarray) -> np.ndarray:
        """What the agent does in place of its action."""
        return action


class Late(Disturbed):
    """An agent whose actions come so many steps later [steps], after its first one.

    The first action is carried out until then: what is neutral differs by task.
    """

    def _done(self, action: np.ndarray) -> np.ndarray:
        self._past.append(action)
        return self._past[max(len(self._past) - 1 - int(self._strength), 0)]


class Frozen(Disturbed):
    """An agent that repeats the last one of so many own actions [actions]."""

    def _done(self, action: np.ndarray) -> np.ndarray:
        if len(self._past) < self._strength:
            self._past.append(action)
        return self._past[-1]


class Dropped(Disturbed):
    """An agent whose views are lost with a probability: it sees the last one again."""

    def _shown(self, view: np.ndarray) -> np.ndarray:
        lost = self._rng.random() < self._strength
        self._past = self._past if lost and self._past else [view]
        return self._past[-1]


class Noisy(Disturbed):
    """An agent with Gaussian noise on its view [spreads of the state's entries]."""

    def _shown(self, view: np.ndarray) -> np.ndarray:
        noise = self._rng.standard_normal(len(view))
        return view + self._strength * self._spread * noise


class Mixed:
    """A policy in which agents are replaced by those of other policies.

    Of a joint actor that replaces an agent, the entries that the agent sets are taken.

    Args:
        policy: Policy of the other agents.
        others: Policies by the names of the agents that they replace.
    """

    def __init__(self, policy: Policy, others: Mapping[str, Policy]) -> None:
        self._policy = policy
        try:
            self._others = {name: deepcopy(other) for name, other in others.items()}
        except TypeError as error:
            named = ", ".join(other.name for other in others.values())
            raise UsageError(
                f"{named} cannot be copied ({error}), as a policy is that takes an "
                "agent's place: give it __deepcopy__"
            ) from None
        named = ", ".join(f"{name} of {o.name}" for name, o in self._others.items())
        self.name = f"{policy.name} with {named}"

    def describe(self) -> dict[str, Any]:
        """Settings of the policy, and of each other one by its agent."""
        others = {name: other.describe() for name, other in self._others.items()}
        return {**self._policy.describe(), "replaced": others}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Begin an episode of every policy, with the same random numbers for each."""
        sets = {agent.name: list(agent.action) for agent in layout.agents}
        self._parts = [(sets[name], other) for name, other in self._others.items()]
        for other in self._others.values():
            other.begin(deepcopy(rng), layout)
        self._policy.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The policy's action, with the replaced agents' parts from the others."""
        action = np.array(self._policy.act(state.copy()))
        for places, other in self._parts:
            action[places] = np.asarray(other.act(state.copy()))[places]
        return action


def disturbed(
    kind: type[Disturbed],
    policy: Policy,
    agent: AgentLayout,
    strength: float,
    spread: np.ndarray,
) -> Policy:
    """A policy of which one agent is disturbed; see ``Disturbed`` for the arguments."""
    changed = kind(policy, agent, strength, spread)
    joint = JOINT_NAME in getattr(policy, "agents", ())
    return changed if joint else Mixed(policy, {agent.name: changed})
