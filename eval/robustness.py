"""Robustness: a policy under disturbances, goal by goal beside the clean run.

Every condition has the goals and the seeds of the clean run, so that differences are
paired. What does not apply to a task is left out, and named.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.envs.rollout import Rollouts
from marl_mm.eval.disturbances import disturbed
from marl_mm.eval.evaluate import Evaluation, Setup
from marl_mm.eval.metrics import failures_in_words
from marl_mm.eval.suite import ROBUSTNESS, Condition, conditions
from marl_mm.eval.tables import (
    markdown_table,
    percent_with_interval,
    points_with_interval,
)
from marl_mm.notebook import html_table
from marl_mm.policy import Policy
from marl_mm.progress import Bar


@dataclass(frozen=True)
class Robustness:
    """Evaluations of a policy under disturbances, and the clean one."""

    clean: Evaluation
    """Evaluation without a disturbance."""

    disturbed: Mapping[Condition, Evaluation]
    """Evaluations by condition, on the goals of the clean one."""

    left_out: Mapping[str, str]
    """Reasons why disturbances do not apply, by their names."""

    def difference(self, condition: Condition) -> tuple[float, tuple[float, float]]:
        """Success rate less the clean one, and its paired 95 % interval."""
        return self.disturbed[condition].less(self.clean)

    header = (
        *("disturbance", "agent", "strength", "success % [95 %]"),
        *("difference, points [95 %]", "return", "failed"),
    )
    """Headings of the table."""

    @property
    def title(self) -> str:
        """Title of the table."""
        return self.clean.policy

    def table_rows(self) -> list[tuple[str, ...]]:
        """A row per condition, formatted; the first is the clean run."""
        rows = [("clean", "", "", *_numbers(self.clean, ""))]
        for condition, evaluation in self.disturbed.items():
            same = evaluation.engine == self.clean.engine
            amount = condition.amount if same else evaluation.engine
            about = condition.disturbance, condition.agent, amount
            text = points_with_interval(*self.difference(condition))
            rows.append((*about, *_numbers(evaluation, text)))
        return rows

    def markdown(self) -> str:
        """The table as Markdown, and what is left out."""
        return f"{markdown_table(self.header, self.table_rows())}\n{self.note}\n"

    @property
    def note(self) -> str:
        """Task and engine of the clean run, and what is left out, in a line."""
        left = [f"{name} ({why})" for name, why in self.left_out.items()]
        about = f"{self.clean.task}, engine: {self.clean.engine}"
        return "; left out: ".join(filter(None, (about, ", ".join(left))))

    def __repr__(self) -> str:
        return (
            f"<Robustness: {self.clean.policy} on {self.clean.task}, "
            f"{len(self.disturbed)} conditions of {len(self.clean.rows)} goals>"
        )

    def _repr_html_(self) -> str:
        """The table, for notebooks."""
        return f"{html_table(self.table_rows(), self.header)}<p>{escape(self.note)}</p>"

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON values: evaluations as in ``eval.json``."""
        return {
            "clean": self.clean.to_json(),
            "disturbed": [
                {
                    "disturbance": condition.disturbance,
                    "agent": condition.agent,
                    "strength": condition.strength,
                    "unit": ROBUSTNESS[condition.disturbance].unit,
                    "difference": self.difference(condition)[0],
                    "difference_interval": self.difference(condition)[1],
                    **evaluation.to_json(),
                }
                for condition, evaluation in self.disturbed.items()
            ],
            "left_out": dict(self.left_out),
        }


def _numbers(evaluation: Evaluation, difference: str) -> tuple[str, ...]:
    summary = evaluation.summary["all"]
    failures = summary.get("failures")
    return (
        percent_with_interval(summary["success_rate"], summary["interval"]),
        difference,
        f"{summary['return']:.2f}",
        "-" if failures is None else failures_in_words(failures),
    )


def robustness(
    setup: Setup,
    policy: Policy,
    called: str,
    bar: Bar,
    names: Sequence[str] = tuple(ROBUSTNESS),
    spread: np.ndarray | None = None,
) -> Iterator[Robustness]:
    """Evaluate a policy clean, and then under each condition.

    Args:
        setup: Task and goals.
        policy: Policy to evaluate.
        called: Name of the policy in tables.
        bar: Factory of progress bars.
        names: Names of the disturbances.
        spread: Spread of the joint state's entries, shape (n,), in their units; default
            their standard deviation over the clean run.

    Yields:
        The results so far, after each evaluation; the last has all.

    Raises:
        UsageError: Before the first, if there is no such disturbance.
    """
    listed, left_out = conditions(setup.task, setup.overrides, names)
    agents = {agent.name: agent for agent in setup.made.layout.agents}
    advance = bar(Path(called).name, setup.episodes * (1 + len(listed)))

    def run(
        goals: Setup, rollouts: Rollouts, actor: Policy, what: object, **more: Any
    ) -> Evaluation:
        def note(done: int, text: str) -> None:
            advance(done, f"{what}: {text}")

        return replace(goals.run(rollouts, actor, note, **more), policy=called)

    with setup.rollouts() as rollouts:
        states: list[np.ndarray] = []
        clean = run(setup, rollouts, policy, "clean", states=states)
        result = Robustness(clean, {}, left_out)
        yield result
        if spread is None:
            spread = np.concatenate(states).std(axis=0)
        for condition in listed:
            how = ROBUSTNESS[condition.disturbance].how
            if isinstance(how, type):
                agent, strength = agents[condition.agent], float(condition.strength)
                actor = disturbed(how, policy, agent, strength, spread)
                evaluation = run(setup, rollouts, actor, condition)
            else:
                changed = replace(setup, overrides=condition.overrides)
                with changed.rollouts() as others:
                    evaluation = run(changed, others, policy, condition)
            done = {**result.disturbed, condition: evaluation}
            result = replace(result, disturbed=done)
            yield result
