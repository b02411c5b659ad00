"""Settings of runs: of all, of offline and of online ones."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.loggers import DEFAULT_LOGGERS, check_loggers
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.algorithms.schedule import Schedule
from marl_mm.runs.settings import check_positive, check_seed, refuse_both
from marl_mm.sim.config import Engine, engine_overrides

Device = Literal["cpu", "cuda"]
"""Device of offline training."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """Settings of every run."""

    clock: ClassVar[str]
    """Hyper-parameter with the length of a run."""

    counter: ClassVar[str]
    """Key of the progress in rows of ``metrics.jsonl``."""

    continued: ClassVar[tuple[str, ...]]
    """Settings of a run that may grow when it is resumed: more of it only continues.
    (The evaluation at the former end stays in the learning curve, and counts.)"""

    algorithm: str
    """Registered name of the algorithm."""

    config: Any
    """Hyper-parameters."""

    preset: str = TUNED
    """Preset that the hyper-parameters start from: tuned (ours), benchmark (what the
    tuning chose on data of coordination tasks) or paper (the source paper's Tables 2
    and 3); an algorithm may lack the last two."""

    eval_episodes: int = 100
    """Number of goals of the evaluation after training, kept in eval.json."""

    eval_seed: int = 0
    """Seed of those goals. The learning curve has goals of its own, of the next
    seed."""

    curve_episodes: int = 20
    """Number of goals per point of the learning curve; online 50."""

    max_steps: int | None = None
    """Steps of an episode, of evaluations too; default the task's."""

    engine: Engine | None = None
    """Engine of the simulation, bullet or mujoco; default the dataset's, or
    bullet, or mujoco where PyBullet is not installed."""

    workers: int = 1
    """Processes that run episodes, and that train seeds from a dataset. The result does
    not depend on their number."""

    logger: tuple[str, ...] = DEFAULT_LOGGERS
    """Loggers beside metrics.jsonl: tensorboard, csv, wandb (Weights & Biases)."""

    resume: bool = False
    """Go on where runs were stopped; seeds without a run start. Settings that are left
    out are those of the first run in the folder."""

    allow_changed_plugin: bool = False
    """Go on, when resuming, though a plug-in is another file than before. The run's
    config keeps both hashes."""

    overwrite: bool = False
    """Start anew where a run exists."""

    @property
    def side_by_side(self) -> bool:
        """Whether several seeds learn in one process, which takes little longer."""
        return False

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        steps = {} if self.max_steps is None else {"max_steps": self.max_steps}
        return {**steps, **engine_overrides(self.engine)}

    def check(self) -> None:
        """Raise a UsageError that names the first setting that makes no sense."""
        check_positive(eval_episodes=self.eval_episodes, workers=self.workers)
        check_seed(self.eval_seed)
        refuse_both(self.resume, self.overwrite)
        check_loggers(self.logger)

    @property
    def recorded(self) -> dict[str, Any]:
        """Settings that a run's record holds beside the hyper-parameters."""
        names = ["curve_episodes", "eval_episodes", "eval_seed"]
        names += ["logger"] if self.logger != DEFAULT_LOGGERS else []
        return {name: getattr(self, name) for name in names}


SWITCHES = ("logger", "require_success", "stop_diverging")
"""Settings that change nothing of what a run learns, recorded where they are not the
default."""


@dataclass(frozen=True, kw_only=True)
class Offline(Training):
    """Settings of runs that learn from a dataset."""

    clock = "updates"
    counter = "step"
    continued = ("updates", "online_steps")

    task: str | None = None
    """Task that is evaluated in; default the dataset's."""

    require_success: bool = True
    """Refuse a dataset in which no episode reaches its goal."""

    device: Device = "cpu"
    """Device to train on. On a CPU each seed is a process of one thread, about as many
    at once as there are workers; on a GPU all seeds are trained side by side, or one
    after the other where own episodes follow."""

    curve_every: int = 2_000
    """Updates between points of the learning curve."""

    fine_tuning: FineTuning = field(default_factory=FineTuning)
    """Own episodes after the updates from the dataset."""

    start: str | Path | None = None
    """Run of the same algorithm, or folder of such runs by seed, whose networks and
    learning curve the new one starts from."""

    stop_diverging: bool = True
    """Stop a run when a critic's values are a hundred times what any return can be;
    otherwise only when a number is not finite."""

    @property
    def side_by_side(self) -> bool:
        """Whether several seeds learn in one process: on a GPU, offline alone."""
        return self.device == "cuda" and not self.fine_tuning.online_steps

    @property
    def recorded(self) -> dict[str, Any]:
        """Settings that a run's record holds beside the hyper-parameters."""
        names = ["device", "max_steps", "curve_every"]
        switches = ("require_success", "stop_diverging")
        names += [name for name in switches if not getattr(self, name)]
        own = asdict(self.fine_tuning) if self.fine_tuning.online_steps else {}
        begun = {} if self.start is None else {"start": str(Path(self.start).resolve())}
        settings = {name: getattr(self, name) for name in names}
        return settings | super().recorded | own | begun


@dataclass(frozen=True, kw_only=True)
class Online(Training):
    """Settings of runs that learn from episodes of their own."""

    clock = "episodes"
    counter = "episode"
    continued = ("episodes", "patience")

    task: str = "Reach-v0"
    """Task to learn."""

    demonstrations: str | Path | None = None
    """Dataset, id or path, whose episodes are replayed, too."""

    engine: Engine | None = None
    """Engine of the simulation; default that of the demonstrations, or bullet, or
    mujoco without PyBullet."""

    curve_episodes: int = 50
    """Number of goals of each point of the learning curve."""

    schedule: Schedule = field(default_factory=Schedule)
    """Times of checkpoints and evaluations."""

    @property
    def recorded(self) -> dict[str, Any]:
        """Settings that a run's record holds beside the hyper-parameters."""
        steps = {} if self.max_steps is None else {"max_steps": self.max_steps}
        return {**steps, **super().recorded, **asdict(self.schedule)}


def training_of(algorithm: str, name: str = TUNED, **settings: Any) -> Offline | Online:
    """Settings of an algorithm's runs, whichever way it learns, with some replaced."""
    kind = Online if ALGORITHMS.get(algorithm).online else Offline
    config = preset(algorithm, name)
    return kind(algorithm=algorithm, config=config, preset=name, **settings)
