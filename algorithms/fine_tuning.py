"""Settings of going on online; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.config_checks import check_numbers


@dataclass(frozen=True, kw_only=True)
class FineTuning:
    """How a run from a dataset goes on with episodes of its own."""

    online_steps: int = 0
    """Env steps of own episodes after the updates from the dataset alone; 0: none. A
    cycle that has begun is completed."""

    kept: float = 0.5
    """Share of the transitions that still comes from the dataset (Ball 2023: half)."""

    updates_per_step: int = 1
    """Gradient steps per own env step."""

    online_noise: float = 0.1
    """Standard deviation of the noise on own actions, in halves of their range."""

    online_cycle: int = 4
    """Own episodes between updates, which one policy runs, in parallel with workers."""

    online_every: int = 500
    """Own env steps between checkpoints, rows of metrics and evaluations."""

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive=("updates_per_step", "online_cycle", "online_every"),
            not_negative=("online_steps", "online_noise"),
            shares=("kept",),
        )
