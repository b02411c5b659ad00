"""Cross-play: what teams reach in which one agent is that of another run.

Teams of the same agents are evaluated once: of two agents, the first of run 1 beside
the second of run 2 is what is left of either run.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import product
from typing import Any

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.eval.disturbances import Mixed
from marl_mm.eval.evaluate import Evaluation, Setup
from marl_mm.eval.tables import (
    markdown_table,
    percent_with_interval,
    points_with_interval,
)
from marl_mm.notebook import html_table
from marl_mm.policy import Policy
from marl_mm.progress import Bar

Team = tuple[int, ...]
"""Number of the run that each agent is of, in the order of the agents."""


@dataclass(frozen=True)
class CrossPlay:
    """Evaluations of teams of several runs' agents."""

    policies: tuple[str, ...]
    """Names of the runs."""

    agents: tuple[str, ...]
    """Names of the agents."""

    evaluations: Mapping[Team, Evaluation]
    """Evaluations by team, of the teams that are finished."""

    title = "agents of other runs"
    """Title of the table."""

    def team(self, agent: str, own: int, other: int) -> Team:
        """The team of a run in which an agent is that of another run.

        Raises:
            UsageError: If there is no such agent or run.
        """
        last = len(self.policies) - 1
        if agent not in self.agents or not {own, other} <= {*range(last + 1)}:
            raise UsageError(
                f"no team of {agent!r} of runs {own} and {other}, expected "
                f"{' or '.join(self.agents)}, and 0 to {last}"
            )
        return tuple(other if name == agent else own for name in self.agents)

    def difference(
        self, agent: str, own: int, other: int
    ) -> tuple[float, tuple[float, float]]:
        """Success rate with another run's agent less a run's own, see ``less``."""
        team = self.team(agent, own, other)
        return self.evaluations[team].less(self.evaluations[self._own(own)])

    def _own(self, number: int) -> Team:
        """The team of a run itself."""
        return (number,) * len(self.agents)

    def table_rows(self) -> list[tuple[str, ...]]:
        """Goals reached [%] and change [points], a row per agent and run."""
        numbers = range(len(self.policies))
        return [
            (
                agent,
                f"{own + 1}: {self.policies[own]}",
                *(self._reached(agent, own, other) for other in numbers),
            )
            for agent, own in product(self.agents, numbers)
        ]

    def _reached(self, agent: str, own: int, other: int) -> str:
        team = self.team(agent, own, other)
        if team not in self.evaluations:
            return "-"
        summary = self.evaluations[team].summary["all"]
        text = percent_with_interval(summary["success_rate"], summary["interval"])
        if own == other or self._own(own) not in self.evaluations:
            return text
        return f"{text}, {points_with_interval(*self.difference(agent, own, other))}"

    @property
    def header(self) -> tuple[str, ...]:
        """Headings of the table."""
        numbers = range(1, len(self.policies) + 1)
        return "agent", "of run", *(f"from {n} %, change [95 %]" for n in numbers)

    @property
    def note(self) -> str:
        """Task, goals and engine, in a line."""
        first = next(iter(self.evaluations.values()))
        goals = f"{len(first.rows)} goals of {first.task}"
        return f"{goals}, engine: {first.engine}"

    def markdown(self) -> str:
        """The table as Markdown."""
        return f"{markdown_table(self.header, self.table_rows())}\n{self.note}\n"

    def __repr__(self) -> str:
        return f"<CrossPlay: {len(self.policies)} runs, {self.note}>"

    def _repr_html_(self) -> str:
        """The table, for notebooks."""
        return f"{html_table(self.table_rows(), self.header)}<p>{escape(self.note)}</p>"

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values: evaluations as in ``eval.json``."""
        numbers = range(len(self.policies))
        return {
            "policies": list(self.policies),
            "teams": [
                {
                    "agents": {
                        name: self.policies[number]
                        for name, number in zip(self.agents, team, strict=True)
                    },
                    **evaluation.to_json(),
                }
                for team, evaluation in self.evaluations.items()
            ],
            "differences": [
                {
                    "agent": agent,
                    "of": self.policies[own],
                    "from": self.policies[other],
                    "difference": self.difference(agent, own, other)[0],
                    "difference_interval": self.difference(agent, own, other)[1],
                }
                for agent, own, other in product(self.agents, numbers, numbers)
                if own != other
                and {self.team(agent, own, other), self._own(own)}
                <= self.evaluations.keys()
            ],
        }


def cross_play(
    setup: Setup, policies: Sequence[Policy], called: Sequence[str], bar: Bar
) -> Iterator[CrossPlay]:
    """What is known after each team, the runs' own teams first.

    Args:
        setup: Task and goals.
        policies: Policies of the same task.
        called: Their names in tables.
        bar: Factory of progress bars.

    Raises:
        LayoutError: If a policy is made for another layout than the task has.
    """
    layout = setup.made.layout
    for policy in policies:  # before any work is done
        policy.begin(np.random.default_rng(0), layout)
    agents = tuple(agent.name for agent in layout.team)
    result = CrossPlay(tuple(called), agents, {})
    numbers = range(len(policies))
    teams: dict[Team, Policy] = {
        (number,) * len(agents): policies[number] for number in numbers
    }
    for agent, own, other in product(agents, numbers, numbers):
        mixed = Mixed(policies[own], {agent: policies[other]})
        teams.setdefault(result.team(agent, own, other), mixed)
    advance = bar("cross-play", setup.episodes * len(teams))
    with setup.rollouts() as rollouts:
        for team, policy in teams.items():
            evaluation = replace(
                setup.run(rollouts, policy, advance),
                policy=" + ".join(f"{called[n]}" for n in team),
            )
            done = {**result.evaluations, team: evaluation}
            result = replace(result, evaluations=done)
            yield result
