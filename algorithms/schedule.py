"""Schedule of online learning; importing it takes no torch."""

from dataclasses import dataclass

from marl_mm.errors import UsageError


@dataclass(frozen=True)
class Schedule:
    """Times of checkpoints and evaluations, and the end of training."""

    epoch: int = 20
    """Episodes between checkpoints and rows of metrics (Table 2)."""

    evaluate_every: int = 2
    """Epochs between evaluations."""

    patience: int = 500
    """Episodes without a better success rate after which training ends, once the rate
    has been over one half; 0 trains all episodes."""

    def __post_init__(self) -> None:
        for name in ("epoch", "evaluate_every"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} is {getattr(self, name)}, expected >= 1")
        if self.patience < 0:
            raise UsageError(f"patience is {self.patience}, expected >= 0")
