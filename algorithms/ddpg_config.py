"""Hyper-parameters of DDPG, by preset; importing them takes no torch."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED, Algorithm, Imported
from marl_mm.declared import ADDED
from marl_mm.errors import UsageError


@dataclass(frozen=True)
class DdpgConfig:
    """Hyper-parameters; those without a source in brackets are ours.

    ``marl-mm ablate online`` measures each of ours that departs from Table 2.
    """

    episodes: int = 2_000
    """Episodes in all: 100 epochs of 20 (Table 2)."""

    hindsight: int = 4
    """Relabelled transitions per original one; 0: none (Andrychowicz 2017)."""

    updates_per_episode: int = 40
    """Gradient steps per episode; the paper's Algorithm 1 makes one per step, 25."""

    episodes_per_cycle: int = 4
    """Episodes between updates, which one policy runs, in parallel with workers."""

    warm_up: int = 1_000
    """Steps with random actions before the first update; 5,000 in Table 2."""

    capacity: int = 50_000
    """Steps in the replay; 5,000 in Table 2."""

    noise: float = 0.1
    """Standard deviation of the exploration's Gaussian noise, in halves of the action's
    range (Table 2)."""

    random_share: float = 0.0
    """Share of exploring steps that act uniformly at random."""

    batch_size: int = 256
    """Transitions per update (Table 2)."""

    actor_learning_rate: float = 1e-3
    """Learning rate of the actor's Adam (Table 2)."""

    critic_learning_rate: float = 1e-3
    """Learning rate of the critic's Adam (Table 2)."""

    discount: float = 0.95
    """Discount per step, gamma (Table 2)."""

    target_rate: float = 0.005
    """Share of the networks that goes into their targets per update, tau (Table 2)."""

    clip_targets: bool = True
    """Whether the critic's targets are clipped at the task's highest return, where it
    has one: of one goal the reward of a perfect hit (Andrychowicz 2017, app. A)."""

    layer_norm: bool = True
    """Whether the critic's hidden layers are normalised, so that values of actions
    that were never tried stay in bounds (Ball 2023)."""

    action_penalty: float = 0.5
    """Weight of the mean square action in the actor's loss; it draws alpha to 0.5,
    too."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers of actor and critic; the paper is silent."""

    std_floor: float = 0.01
    """Least standard deviation an observation is scaled by."""

    demonstration_share: float = 0.25
    """Share of a batch that comes from demonstrations, if there are any."""

    demonstration_successes: float = 0.75
    """Share of these demonstrations that comes from successful episodes."""

    imitation_weight: float = field(default=0.0, metadata=ADDED)
    """Weight of the mean square error at demonstrated actions in the actor's loss, of
    those that the critic values above the actor's own (Nair 2018); 0: none."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive=(
                "episodes",
                "updates_per_episode",
                "episodes_per_cycle",
                "capacity",
                "batch_size",
                "actor_learning_rate",
                "critic_learning_rate",
                "target_rate",
                "std_floor",
            ),
            not_negative=(
                "hindsight",
                "warm_up",
                "noise",
                "action_penalty",
                "imitation_weight",
            ),
            shares=(
                "random_share",
                "discount",
                "target_rate",
                "demonstration_share",
                "demonstration_successes",
            ),
        )
        if self.warm_up > self.capacity:
            raise UsageError(
                f"warm_up is {self.warm_up}, expected at most capacity, {self.capacity}"
            )


TABLE_2: dict[str, Any] = {
    "updates_per_episode": 25,  # one per step of a whole episode (Algorithm 1)
    "episodes_per_cycle": 1,
    "warm_up": 5_000,  # Table 2
    "capacity": 5_000,  # Table 2
    "noise": 0.1,  # Table 2
    "random_share": 0.0,
    "action_penalty": 0.0,
    "clip_targets": False,
    "layer_norm": False,
}
"""Hyper-parameters of Table 2, and the plain choice where it is silent."""


def check_hindsight(algorithm: str, config: DdpgConfig) -> None:
    """Raise if ``hindsight`` is that of the other algorithm, with or without it.

    Raises:
        UsageError: Naming the other algorithm.
    """
    if (config.hindsight > 0) != algorithm.endswith("-her"):
        other = algorithm.removesuffix("-her") + "-her" * (config.hindsight > 0)
        raise UsageError(
            f"`hindsight` is {config.hindsight} with {algorithm}: use {other}"
        )


ALGORITHMS.add(
    "ddpg",
    Algorithm(
        title="DDPG",
        loss="-Q(s, pi(s)) + penalty mean pi(s)^2",
        about="DDPG: one agent that sees and sets everything (paper, Algorithm 1).",
        source="paper, Algorithm 1; Lillicrap 2016",
        advice="To see what hindsight is worth; else take DDPG + HER, which needs an "
        "eighth of the episodes. It needs the simulator, and a goal that chance "
        "reaches.",
        departs="A replay that forgets less, normalised critics, clipped targets and a "
        "cost of large actions. Undone one at a time, with hindsight, only the shorter "
        "warm-up counts.",
        learner=Imported("marl_mm.algorithms.ddpg:Ddpg"),
        presets={
            TUNED: DdpgConfig(hindsight=0),
            PAPER: DdpgConfig(**TABLE_2, hindsight=0),
        },
        online=True,
        check=partial(check_hindsight, "ddpg"),
    ),
)
ALGORITHMS.add(
    "ddpg-her",
    Algorithm(
        title="DDPG + HER",
        loss="-Q(s, pi(s)) + penalty mean pi(s)^2, on relabelled goals",
        about="DDPG that replays most steps with goals reached later (HER).",
        source="Andrychowicz 2017",
        advice="Without data, where one actor may see everything and chance comes to "
        "goals of some kind: it comes to 95 % of those of `Reach-v0` in about a "
        "hundred episodes. With its preset it grasps nothing.",
        departs="As DDPG: of its numbers only the shorter warm-up counts. Inputs are "
        "scaled by the goals that were set, in the source by exchanged ones, too. "
        "Along an axis where what is reached is more than 20 of their deviations away, "
        "both count alike: that is where all goals are at the same distance, as in "
        "most tasks of teams. Demonstrations do not count in the inputs' scale.",
        learner=Imported("marl_mm.algorithms.ddpg:Ddpg"),
        presets={TUNED: DdpgConfig(), PAPER: DdpgConfig(**TABLE_2)},
        online=True,
        check=partial(check_hindsight, "ddpg-her"),
    ),
)
