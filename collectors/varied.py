"""The varied collector: a team of the task's expert, with agents that do otherwise.

Every agent acts by the expert's action in what it is shown: the state now, a step ago,
or without what only it sees. Then come noise, and agents that act at random.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.collectors.scripted import expert_action
from marl_mm.declared import as_record
from marl_mm.envs.task import ScriptConfig, Task
from marl_mm.errors import UsageError
from marl_mm.layout import Layout, places
from marl_mm.layout_diff import refuse_other_layout

NOBODY: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class VariedConfig(ScriptConfig):
    """Settings of the varied collector."""

    noise: float = 0.0
    """Standard deviation of noise on the actions, in halves of their ranges."""

    noise_memory: float = 0.0
    """Share of the noise that stays from a step to the next, 0 to below 1."""

    held_alpha: float | None = None
    """Alpha that every balance agent holds, 0 to 1; default the expert's."""

    random_agents: tuple[str, ...] = NOBODY
    """Names of agents that act at random."""

    one_random: bool = False
    """Let one agent act at random, drawn for each episode."""

    late_agents: tuple[str, ...] = NOBODY
    """Names of agents that see the state of a step ago."""

    blind_agents: tuple[str, ...] = NOBODY
    """Names of agents that do not see what is hidden from the others."""

    conventions: tuple[str, ...] = NOBODY
    """Convention of each robot; default that of ``convention`` for all."""

    any_convention: bool = False
    """Let the team act by one of the task's conventions, drawn for each episode."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise UsageError(f"noise is {self.noise}, expected >= 0")
        if not 0 <= self.noise_memory < 1:
            raise UsageError(
                f"noise_memory is {self.noise_memory}, expected 0 to below 1"
            )
        if self.noise_memory and not self.noise:
            raise UsageError(
                f"noise_memory is {self.noise_memory}, but noise is 0, so that it has "
                "no effect: leave it at 0"
            )
        ways = "convention", "conventions", "any_convention"
        if len(given := [name for name in ways if getattr(self, name)]) > 1:
            raise UsageError(f"{' and '.join(given)} are given, expected one of them")
        if self.held_alpha is not None and not 0 <= self.held_alpha <= 1:
            raise UsageError(f"held_alpha is {self.held_alpha}, expected 0 to 1")


class VariedPolicy:
    """Policy of a team of experts, some of which do otherwise.

    Args:
        config: Settings.
        task: Task whose expert acts.

    Raises:
        UsageError: If the task has no such agent or convention.
    """

    name = "varied"

    def __init__(self, config: VariedConfig, task: Task) -> None:
        self.config, self._task = config, task
        layout = task.layout
        names = [agent.name for agent in layout.team]
        for name in (
            *config.random_agents,
            *config.late_agents,
            *config.blind_agents,
        ):
            if name not in names:
                raise UsageError(f"no agent {name!r}, expected {' or '.join(names)}")
        for agent in layout.team:
            if agent.name in config.blind_agents and not {*task.hidden} & {*agent.sees}:
                raise UsageError(
                    f"agent {agent.name!r} cannot be blind: it sees nothing that is "
                    f"hidden from others in {type(task).__name__}"
                )
        conventions = config.conventions or (config.convention,) * task.robots
        if len(conventions) != task.robots:
            raise UsageError(
                f"conventions has {len(conventions)} words, expected one for each of "
                f"{task.robots} robots"
            )
        self._conventions = conventions
        for word in conventions:
            task.check_script(self._script(word))
        if config.any_convention and not task.conventions:
            raise UsageError(f"{type(task).__name__} has no conventions to draw from")
        self._sets = [[*places(layout.action_names, a.sets)] for a in layout.team]
        self._low, self._high = np.array(layout.low), np.array(layout.high)
        self._alphas = [
            i for i, name in enumerate(layout.action_names) if name.endswith("alpha")
        ]

    def describe(self) -> dict[str, Any]:
        """The config."""
        return as_record(self.config)

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Draw what the episode's team is like."""
        refuse_other_layout("the script", self._task.layout, "the task", layout)
        config, task = self.config, self._task
        self._rng = rng
        self._before: np.ndarray | None = None
        self._drift = np.zeros(len(self._low))
        self._words = self._conventions
        self._random = set(config.random_agents)
        if config.any_convention:
            word = task.conventions[rng.integers(len(task.conventions))]
            self._words = (word,) * task.robots
        if config.one_random:
            team = layout.team
            self._random.add(team[rng.integers(len(team))].name)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The team's action."""
        config, team = self.config, self._task.layout.team
        action = np.empty(len(self._low))
        for number, agent in enumerate(team):
            word = self._words[number * self._task.robots // len(team)]
            own = self._sets[number]
            seen = self._shown(agent.name, state)
            action[own] = expert_action(self._task, seen, self._script(word))[own]
        if config.held_alpha is not None:
            action[self._alphas] = config.held_alpha
        self._before = state.copy()  # others may write into their state
        if config.noise:
            fresh = self._rng.normal(0.0, config.noise, len(action))
            stays = config.noise_memory
            self._drift = stays * self._drift + np.sqrt(1 - stays**2) * fresh
            action += self._drift * (self._high - self._low) / 2
        if self._random:
            dice = self._rng.uniform(self._low, self._high)
            for agent, own in zip(team, self._sets, strict=True):
                if agent.name in self._random:
                    action[own] = dice[own]
        return np.clip(action, self._low, self._high).astype(np.float32)

    def _shown(self, agent: str, state: np.ndarray) -> dict[str, float]:
        """What an agent is shown, by name."""
        config, task = self.config, self._task
        if agent in config.late_agents and self._before is not None:
            state = self._before
        seen = dict(zip(task.layout.state_names, state.tolist(), strict=True))
        return seen | dict(task.hidden) if agent in config.blind_agents else seen

    def _script(self, convention: str) -> ScriptConfig:
        alpha, kp = self.config.alpha, self.config.kp
        return ScriptConfig(alpha=alpha, convention=convention, kp=kp)


COLLECTORS.add(
    "varied",
    Collector(
        about="Let a team of the task's expert act, varied: noise, agents at random, "
        "conventions; keep all episodes.",
        config=VariedConfig,
        policy=VariedPolicy,
    ),
)
