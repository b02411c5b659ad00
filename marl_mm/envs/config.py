"""The tasks as data: every number of an episode, with its unit and source."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, get_args

from marl_mm.control.config import ControllerConfig
from marl_mm.control.payload import Knowledge
from marl_mm.errors import UsageError
from marl_mm.layout import HANDLING, REACH, Layout
from marl_mm.robot.description import RobotConfig
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.scene import Grasp

Interval = tuple[float, float]

WIDEST = 0.075
"""Edge of a block that open pads, 0.08 apart, can go around [m]."""


@dataclass(frozen=True)
class LoadConfig:
    """A block in the hand or on a stand, drawn for each episode; all numbers ours."""

    mass: Interval = (0.05, 3.0)
    """[kg]; the arm carries 3 (Franka data sheet)."""

    edge: Interval = (0.04, 0.06)
    """Of the cube [m]."""

    friction: Interval = (0.6, 1.0)
    """Coefficient against the pads."""

    knowledge: Knowledge = "estimated"
    """Where the controller has the mass from: "estimated" from the joints' torques,
    "given", or "none". The policy never sees it."""

    grasp: Grasp = "friction"
    """"friction" holds the block between the pads; "weld" fixes it to the hand."""

    on_stand: bool = False
    """Whether the block is on a stand at first, and not in the hand."""

    stand_x: Interval = (0.60, 0.80)
    """Where the stand, and the block in its middle, is, world [m]."""

    stand_y: Interval = (0.42, 0.52)
    """[m]; on the arm's side, and out of the way of a base that passes it."""

    stand_height: Interval = (0.42, 0.50)
    """[m]"""

    stand_edge: float = 0.14
    """Of its square top [m]."""

    lift: float = 0.0
    """The goal is so far above where the block is at first [m]; 0: it is one of the
    reach task's."""

    hold_ticks: int = 240
    """A block from a stand counts as held once it has been clear of it for so long."""

    failure_reward: float = -10.0
    """Instead of minus the distance, for a drop, a missed grasp, a collision or a block
    out of reach, which end the episode. In the registered tasks it is less than to
    stand still until the end costs, so that it does not pay to fail; with more steps,
    or a load in another task, it is to be lowered."""

    def __post_init__(self) -> None:
        for name in ("mass", "edge", "friction", "stand_height"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise UsageError(
                    f"load.{name} is {low} to {high}, expected 0 < low <= high"
                )
        for name in ("stand_x", "stand_y"):
            low, high = getattr(self, name)
            if not -math.inf < low <= high < math.inf:
                raise UsageError(
                    f"load.{name} is {low} to {high}, expected low <= high"
                )
        if not self.stand_edge >= self.edge[1]:
            raise UsageError(
                f"load.stand_edge is {self.stand_edge}, expected >= load.edge, "
                f"{self.edge[1]}"
            )
        if self.edge[1] > WIDEST:
            raise UsageError(f"load.edge is up to {self.edge[1]}, expected <= {WIDEST}")
        if self.hold_ticks < 0 or not 0 <= self.lift <= 0.5:
            raise UsageError(
                f"load.hold_ticks is {self.hold_ticks} and load.lift {self.lift}, "
                "expected >= 0, and lift <= 0.5"
            )
        if not self.failure_reward < 0:
            raise UsageError(
                f"load.failure_reward is {self.failure_reward}, expected below 0"
            )
        for name, choices in (("knowledge", Knowledge), ("grasp", Grasp)):
            if getattr(self, name) not in get_args(choices):
                expected = ", ".join(get_args(choices))
                raise UsageError(
                    f"load.{name} is {getattr(self, name)!r}, expected {expected}"
                )


@dataclass(frozen=True)
class ReachConfig:
    """One task: bring the end-effector, or a block, to a goal ahead or behind."""

    goal_x_forward: Interval = (1.0, 1.5)
    """Goals ahead, world [m] (paper, Sec. 5.1)."""

    goal_x_backward: Interval = (-0.8, -0.5)
    """Goals behind, world [m] (paper, Sec. 5.1); each direction has equal chance."""

    goal_y: Interval = (-0.2, 0.2)
    """[m] (paper, Sec. 5.1)"""

    goal_z: Interval = (0.55, 0.8)
    """[m] (paper, Sec. 5.1)"""

    max_steps: int = 25
    """Steps until truncation (paper, Tables 2, 3); PD collection uses 50."""

    ticks_per_step: int = 240
    """Controller ticks per policy step: 1 Hz over 240 Hz (paper, Fig. 2)."""

    success_distance: float = 0.05
    """End-effector, or block to be taken, to goal at the end of a step [m]; reaching it
    terminates."""

    action_scale: float = 0.1
    """Largest displacement of the end-effector's target per axis and step [m]; ours,
    as are all numbers below without a source: the paper leaves them open."""

    initial_alpha: float = 1.0
    """Control mode in the first observation, before any alpha was set."""

    random_start_steps: int = 0
    """Random steps before the episode, unseen by the policy."""

    goal_reward: float = 10.0
    """Reward for reaching the goal, instead of minus the distance (Eq. 6)."""

    ee_error_weight: float = 5.0
    """Cost of d_mm [1/m] (Eq. 7)."""

    base_error_weight: float = 5.0
    """Cost of d_mp [1/m] (Eq. 8)."""

    jerk_weight: float = 0.0
    """Cost of the base's rms jerk within a step [s^3/m], see ``INFO``; 0 is the paper's
    reward."""

    cruise: float = 0.03
    """Most the base plan advances per step [m]. A plan that kept up with the hand would
    make all tasks compatible and alpha meaningless."""

    stand_off: float = 0.647
    """The base plan heads for this far behind the hand's target along x [m]: the
    end-effector's distance ahead of the base in the initial posture."""

    standing: float = 0.005
    """A plan that advances less than this has no direction of travel [m]."""

    heading_gain: float = 1.0
    """Heading reference per lateral offset, steering back to y = 0 [rad/m]."""

    heading_limit: float = 0.3
    """Largest heading reference [rad]."""

    look_every: int = 8
    """Ticks between looks at stability: ZMP margin, tilt, slip, the model's error."""

    load: LoadConfig | None = None
    """A block, in the hand or on a stand; None: there is none."""

    robot: RobotConfig = field(default_factory=RobotConfig)

    simulation: SimulationConfig = field(default_factory=SimulationConfig)

    controller: ControllerConfig = field(default_factory=ControllerConfig)

    @property
    def layout(self) -> Layout:
        """Of joint state and action."""
        on_stand = self.load is not None and self.load.on_stand
        return HANDLING if on_stand else REACH

    def __post_init__(self) -> None:
        for name in ("max_steps", "ticks_per_step", "look_every"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} is {getattr(self, name)}, expected >= 1")
        for name in ("success_distance", "action_scale"):
            if not getattr(self, name) > 0:
                raise UsageError(f"{name} is {getattr(self, name)}, expected > 0")
        if not 0.0 <= self.initial_alpha <= 1.0:
            raise UsageError(f"initial_alpha is {self.initial_alpha}, expected [0, 1]")
        ticks = self.max_steps * self.ticks_per_step
        if self.layout is HANDLING and self.load and self.load.hold_ticks > ticks:
            raise UsageError(
                f"load.hold_ticks is {self.load.hold_ticks}, expected at most an "
                f"episode's {ticks}"
            )


TASKS: dict[str, ReachConfig] = {
    "Reach-v0": ReachConfig(),
    "SmoothReach-v0": ReachConfig(jerk_weight=0.2),
    "PreciseReach-v0": ReachConfig(success_distance=0.02, random_start_steps=8),
    "CarryReach-v0": ReachConfig(load=LoadConfig(failure_reward=-50.0)),
    "Grasp-v0": ReachConfig(max_steps=20, load=LoadConfig(on_stand=True, lift=0.1)),
    "GraspReach-v0": ReachConfig(
        max_steps=50, load=LoadConfig(on_stand=True, failure_reward=-100.0)
    ),
}
"""The registered tasks: the paper's reward, with a cost of jerk, with a finer goal;
with a load in the hand, with one to be lifted, with one to be lifted and carried."""


def reach_config(
    task: str = "Reach-v0", overrides: Mapping[str, Any] | None = None
) -> ReachConfig:
    """A registered task's config, with some fields replaced.

    Args:
        task: One of ``TASKS``.
        overrides: Fields to replace, nested as the config is, for example
            ``{"max_steps": 50, "controller": {"form": "rhp"}}``.

    Raises:
        UsageError: If the task or a field does not exist.
    """
    if task not in TASKS:
        raise UsageError(f"unknown task {task!r}, expected one of {', '.join(TASKS)}")
    config: ReachConfig = _replaced(TASKS[task], overrides or {}, "")
    return config


def config_dict(config: Any) -> Any:
    """A config as nested dictionaries, JSON-serialisable."""
    if is_dataclass(config):
        return {f.name: config_dict(getattr(config, f.name)) for f in fields(config)}
    if hasattr(config, "_asdict"):
        return {name: config_dict(value) for name, value in config._asdict().items()}
    return config


def _replaced(config: Any, overrides: Mapping[str, Any], path: str) -> Any:
    if is_dataclass(config):
        known = [item.name for item in fields(config)]
    else:
        known = list(config._fields)
    changes = {}
    for name, value in overrides.items():
        if name not in known:
            raise UsageError(
                f"unknown field {path + name!r}, expected one of {', '.join(known)}"
            )
        current = getattr(config, name)
        if current is None and isinstance(value, Mapping):
            current = LoadConfig()  # the only one that may be None
        if is_dataclass(current) or hasattr(current, "_asdict"):
            if not isinstance(value, Mapping):
                raise UsageError(
                    f"{path}{name} is {value!r}, expected a mapping of its fields"
                )
            changes[name] = _replaced(current, value, f"{path}{name}.")
        else:
            changes[name] = _like(current, value, path + name)
    if is_dataclass(config) and not isinstance(config, type):
        return replace(config, **changes)
    return config._replace(**changes)


def _like(current: Any, value: Any, name: str) -> Any:
    """A value in the type of the one it replaces.

    Raises:
        UsageError: If it is not of that type, or not finite.
    """
    if isinstance(current, tuple):
        if not isinstance(value, list | tuple) or len(value) != len(current):
            raise UsageError(f"{name} is {value!r}, expected {len(current)} numbers")
        pairs = zip(current, value, strict=True)
        return tuple(_like(one, other, name) for one, other in pairs)
    truth = isinstance(value, bool)
    if isinstance(current, float) and isinstance(value, int | float) and not truth:
        if math.isfinite(value):
            return float(value)
    elif isinstance(value, type(current)) and truth == isinstance(current, bool):
        return value
    kind = "a finite number" if isinstance(current, float) else type(current).__name__
    raise UsageError(f"{name} is {value!r}, expected {kind}")
