"""The PD collector: it steers the hand straight to the goal, with alpha by a rule."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector, successes
from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, names
from marl_mm.errors import LayoutError, UsageError
from marl_mm.layout import Layout

AlphaRule = Literal["constant", "direction", "room"]


@dataclass(frozen=True)
class PdConfig:
    """Settings of the PD collector.

    a = kp (goal - hand) - kd (hand - hand a step ago), clipped.
    """

    kp: float = 10.0
    """Gain from distance to action [1/m]; 10 asks for the goal itself within 0.1 m."""

    kd: float = 1.0
    """Gain from the hand's displacement over the last step to action [1/m]."""

    alpha_rule: AlphaRule = "constant"
    """Rule of alpha. "constant": always ``alpha``. "direction": 1 for goals ahead,
    ``alpha`` behind. "room": from 1 down to ``alpha`` as the hand nears the base."""

    alpha: float = 0.5
    """Alpha of rule "constant", or the lowest alpha of the others: 0 accurate hand ...
    1 stable base. At 0.5 stability has three quarters of the hierarchy."""

    room_start: float = 0.64
    """Distance of the hand ahead of the base at which rule "room" leaves 1 [m]."""

    room_end: float = 0.47
    """Distance of the hand ahead of the base at which rule "room" is ``alpha`` [m]."""

    def __post_init__(self) -> None:
        for name in ("kp", "kd", "room_start", "room_end"):
            if not np.isfinite(getattr(self, name)):
                raise UsageError(
                    f"{name} is {getattr(self, name)}, expected a finite number"
                )
        if self.room_start <= self.room_end:
            raise UsageError(
                f"room starts at {self.room_start} m and ends at {self.room_end} m, "
                "expected it to end nearer to the base"
            )
        if not 0.0 <= self.alpha <= 1.0:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        if self.alpha_rule not in ("constant", "direction", "room"):
            raise UsageError(
                f"alpha rule is {self.alpha_rule!r}, "
                "expected constant, direction or room"
            )


class PdPolicy:
    """Proportional-derivative control of the hand's target."""

    name = "pd"

    def __init__(self, config: PdConfig) -> None:
        self.config = config

    def describe(self) -> dict[str, Any]:
        """The config."""
        return asdict(self.config)

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Forget the position of the hand in the last episode.

        Raises:
            LayoutError: If the layout has no hand, base or goal, or other actions than
                a displacement and alpha.
        """
        others = {*layout.action_names} - {*names(*DELTA, ALPHA)}
        lacking = {*names(*HAND, *BASE, *GOAL)} - {*layout.state_names}
        if others or lacking:
            entries = sorted(others or lacking)
            some = ", ".join(entries[:3]) + (" and others" if entries[3:] else "")
            raise LayoutError(
                f"pd {'does not set' if others else 'needs'} {some}: choose another "
                "policy, such as scripted"
            )
        self._last_ee: np.ndarray | None = None
        self._hand = layout.columns(*names(*HAND))
        self._base = layout.columns(*names(*BASE))
        self._goal = layout.columns(*names(*GOAL))
        self._delta = layout.settings(*names(*DELTA))
        self._alpha_place = layout.settings(ALPHA.name)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The PD action, a function of the episode's states so far."""
        config = self.config
        hand, goal = state[self._hand], state[self._goal]
        moved = np.zeros(3) if self._last_ee is None else hand - self._last_ee
        self._last_ee = hand.copy()  # others may write into their state
        action = np.empty(4, np.float32)
        action[self._delta] = config.kp * (goal - hand) - config.kd * moved
        action[self._delta] = np.clip(action[self._delta], -1.0, 1.0)
        action[self._alpha_place] = self._alpha(hand, state[self._base], goal)
        return action

    def _alpha(self, hand: np.ndarray, base: np.ndarray, goal: np.ndarray) -> float:
        config = self.config
        if config.alpha_rule == "constant":
            return config.alpha
        if config.alpha_rule == "direction":
            return 1.0 if goal[0] > hand[0] else config.alpha
        x, y, yaw = base
        ahead = (hand[0] - x) * np.cos(yaw) + (hand[1] - y) * np.sin(yaw)
        share = (ahead - config.room_end) / (config.room_start - config.room_end)
        return float(config.alpha + (1 - config.alpha) * np.clip(share, 0.0, 1.0))


COLLECTORS.add(
    "pd",
    Collector(
        about="Steer the hand to the goal; keep the episodes that reach it.",
        config=PdConfig,
        policy=lambda config, task: PdPolicy(config),
        keeps=successes,
        max_steps=50,  # paper, Sec. 5.4
    ),
)
