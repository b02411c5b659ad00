"""The PD collector: steer the hand straight to the goal, alpha by a declared rule."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.layout import ALPHA, BASE, DELTA, EE, GOAL, REACH, check_state

AlphaRule = Literal["constant", "direction", "room"]


@dataclass(frozen=True)
class PdConfig:
    """a = kp (goal - hand) - kd v_hand, clipped to the action space."""

    kp: float = 10.0
    """Action per distance [1/m]; 10 asks for the goal itself within 0.1 m."""

    kd: float = 1.0
    """Action per speed of the hand over the last step [s/m]."""

    alpha_rule: AlphaRule = "constant"
    """"constant": always ``alpha``. "direction": 1 for goals ahead, ``alpha`` behind.
    "room": from 1 down to ``alpha`` as the hand nears its own base."""

    alpha: float = 0.5
    """The constant, or the rule's lowest value; 0 accurate hand ... 1 stable base. At
    0.5 stability has three quarters of the hierarchy."""

    room_start: float = 0.64
    """Hand ahead of the base at which rule "room" leaves 1 [m]."""

    room_end: float = 0.47
    """Hand ahead of the base at which rule "room" reaches ``alpha`` [m]."""

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

    @property
    def name(self) -> str:
        """Of the collector."""
        return "pd"


class PdPolicy:
    """Proportional-derivative control of the hand's target."""

    name = "pd"

    def __init__(self, config: PdConfig) -> None:
        self.config = config

    def describe(self) -> dict[str, Any]:
        """The config."""
        return asdict(self.config)

    def begin(self, rng: np.random.Generator) -> None:
        """Forget the last episode's hand."""
        self._last_ee: np.ndarray | None = None

    def act(self, state: np.ndarray) -> np.ndarray:
        """Deterministic in the episode's states.

        Raises:
            UsageError: If they are of a task with a block to be taken.
        """
        check_state(state, REACH)
        config = self.config
        hand = state[EE]
        speed = np.zeros(3) if self._last_ee is None else hand - self._last_ee
        self._last_ee = hand
        action = np.empty(4, np.float32)
        action[DELTA] = config.kp * (state[GOAL] - hand) - config.kd * speed
        action[DELTA] = np.clip(action[DELTA], -1.0, 1.0)
        action[ALPHA] = self._alpha(state)
        return action

    def _alpha(self, state: np.ndarray) -> float:
        config = self.config
        if config.alpha_rule == "constant":
            return config.alpha
        if config.alpha_rule == "direction":
            return 1.0 if state[GOAL][0] > state[EE][0] else config.alpha
        x, y, yaw = state[BASE]
        ahead = (state[0] - x) * np.cos(yaw) + (state[1] - y) * np.sin(yaw)
        share = (ahead - config.room_end) / (config.room_start - config.room_end)
        return float(config.alpha + (1 - config.alpha) * np.clip(share, 0.0, 1.0))
