"""Who sees what in training and in acting: drawn of what a learner is made of."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from drawings import agent_lines
from svg import COLOURS, INK, arrow, box, drawing, frame, words

from marl_mm.algorithms.networks import Form
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.contracts.learners import candidate, some_episodes
from marl_mm.layout import JOINT_NAME, Agent

HELPERS = {
    "critic": ("critic Q", "of joint state and action", "values"),
    "value": ("value V", "of the joint state", "values"),
    "flow": ("flow teacher", "of joint actions", "actions"),
}
"""Networks that do not act, by name: title, what they are of, and what actors get."""


@dataclass(frozen=True)
class Kind:
    """What algorithms with the same picture have in common."""

    team: bool
    """Whether each agent has an actor of its own."""

    learns: str
    """What they learn from, as ``Algorithm.learns`` says it."""

    helpers: tuple[str, ...]
    """Networks that learn beside the actors, and do not act."""

    form: Form
    """Form of the actors."""

    @property
    def online(self) -> bool:
        """Whether they learn from episodes of their own."""
        return self.learns.startswith("online")

    @property
    def picture(self) -> str:
        """The picture's path below docs/."""
        parts = ["team" if self.team else "joint", *self.helpers]
        parts += ["by-flow" if self.form.flow_steps else "by-noise"] * self.form.noisy
        parts += ["chunk"] * (self.form.chunk > 1) + ["online"] * self.online
        parts += ["data"] * self.learns.endswith("beside a dataset")
        return f"images/sees-{'-'.join(parts)}.svg"

    def draw(self) -> str:
        """The picture, of the paper's two agents."""
        actors, bottom = self._actors()
        last = 80 + 84 * len(self.helpers) if self.helpers else 98
        height = max(bottom + 18, last + 34 + 34 * self.online, 190)
        source = "replay" if self.learns == "online" else "dataset"
        source += ", replay" * self.learns.endswith("beside a dataset")
        gets = "states" if self.online or "flow" in self.helpers else "states, actions"
        way = ((105, 144), (105, last)) if self.helpers else ((180, last),)
        parts = [
            frame(16, 16, 504, height - 32, "in training only"),
            frame(560, 16, 304, height - 32, "in training and acting"),
            box(30, 52, 150, 92, source, "joint states,", "joint actions,", "rewards"),
            *actors,
            *self._learnt(),
            arrow(*way, (558, last)),
            words(290, last - 7, gets, size=12),
        ]
        if self.online:
            noisy = "episodes, with noise on actions"
            parts.append(arrow((560, last + 34), (65, last + 34), (65, 146)))
            parts.append(words(290, last + 27, noisy, size=12))
        return drawing(880, height, parts, "Who sees what in training and in acting")

    def _actors(self) -> tuple[list[str], int]:
        """Boxes of the actors, and where they end."""
        layout = some_episodes().layout
        joint = Agent("joint actor", layout.state_names, layout.action_names)
        boxes, y = [], 50
        for number, agent in enumerate(layout.team if self.team else (joint,)):
            lines = [*agent_lines(agent, 34), *self._draws()]
            name = f"agent {agent.name}" if self.team else agent.name
            colour = COLOURS[number] if self.team else INK
            height = 42 + 17 * len(lines)
            boxes.append(box(574, y, 276, height, name, *lines, colour=colour))
            y += height + 12
        return boxes, y

    def _learnt(self) -> list[str]:
        """Networks beside the actors, between what they learn from and the actors."""
        parts = []
        for number, helper in enumerate(self.helpers):
            title, of, gives = HELPERS.get(helper, (helper, "", ""))
            y = 84.0 + 84 * number
            parts += [
                box(290, y - 32, 200, 62, title, of, colour=COLOURS[3]),
                arrow((180, 84), (235, 84), (235, y), (288, y)),
                arrow((490, y), (558, y)),
                words(496, y - 6, gives, size=12),
            ]
        return parts

    def _draws(self) -> list[str]:
        """How the actors act, where it is not one action by a network without noise."""
        how = "by a flow" if self.form.flow_steps else "in one step"
        draws = [f"draws: from noise, {how}"] * self.form.noisy
        return draws + ["plans several actions"] * (self.form.chunk > 1)


@cache
def kind(name: str) -> Kind:
    """The kind of a registered algorithm, by what its learner holds."""
    tried = candidate(name)
    learner = tried.fresh(some_episodes())
    agents, state = tried.agents(learner), tried.state(learner)
    ends = "_learners", "_optimizer"
    learns = [key.rpartition("_")[0] for key in state if key.endswith(ends)]
    helpers = tuple(each for each in learns if each != "actor")
    form = next(iter(agents.values())).actor.form
    return Kind(JOINT_NAME not in agents, ALGORITHMS.get(name).learns, helpers, form)


PICTURES: dict[str, Callable[[], str]] = {
    kind(name).picture: kind(name).draw for name in ALGORITHMS.names()
}
"""Path below docs/, and what draws it."""
