"""What several test files share: the robot, random states, small datasets."""

import os
import shutil
import signal
import sys

# Tests run beside each other: those of several processes say how many, and threads of
# torch on cores that are taken wait for each other ten times as long as they compute.
os.environ.setdefault("PYTHON_CPU_COUNT", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # read where a library starts its threads

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import psutil
import pytest
from PIL import Image

from marl_mm import plugins
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.collectors import replay
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.control.records import Reference
from marl_mm.datasets import shipped
from marl_mm.datasets.location import Location, datasets_root, locate
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import INFO, Episode
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import METRICS
from marl_mm.layout import Layout
from marl_mm.processes import process_context
from marl_mm.registry import Registry
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState
from marl_mm.sim.config import ENGINES, is_installed

WorkersOf = Callable[[int], list[psutil.Process]]
MakeEpisode = Callable[..., Episode]
OpenWorld = Callable[..., EpisodeCore]
Situation = tuple[RobotState, ModelTerms, Reference]


class _Absent:
    """PyBullet where it is not installed: a test that uses it is skipped."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        pytest.skip("PyBullet is not installed")


if not is_installed("bullet"):
    absent: Any = ModuleType("marl_mm.sim.bullet.engine")
    absent.pybullet = absent.pybullet_data = _Absent()
    sys.modules[absent.__name__] = absent


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Ctrl-C interrupts, and a test that needs PyBullet is skipped without it.

    A shell that runs the tests in the background has it ignored, and so has a command
    that was interrupted in this process, as it is ending.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if item.get_closest_marker("bullet") and not is_installed("bullet"):
        pytest.skip("PyBullet is not installed")
    with skipped_without_bullet():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """So is one that asks for its engine or its pictures itself."""
    with skipped_without_bullet():
        return (yield)


@contextmanager
def skipped_without_bullet() -> Iterator[None]:
    """The package's own error about PyBullet is the reason of a skip."""
    try:
        yield
    except UsageError as error:
        needs = "pip install pybullet", "use engine 'bullet'"
        if is_installed("bullet") or not any(word in str(error) for word in needs):
            raise
        pytest.skip(str(error))


@pytest.fixture(autouse=True, scope="session")
def cache_home(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Derived data go into a folder of the tests."""
    os.environ["MARL_MM_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(autouse=True, scope="session")
def fork_server(request: pytest.FixtureRequest, cache_home: None) -> None:
    """What any worker needs is imported once, whichever test has the first one."""
    if any(item.get_closest_marker("slow") for item in request.session.items):
        process_context("marl_mm.runs.train")


@pytest.fixture(autouse=True, scope="session")
def ships_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A dataset that ships is written once, and copied to every test that uses it."""
    written, install = tmp_path_factory.mktemp("shipped"), shipped.install

    def copied(location: Location) -> None:
        root = written / Path(location.id).name
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("MINARI_DATASETS_PATH", str(root))
            if not locate(location.id).folder.exists():
                install(locate(location.id))
        shutil.copytree(root, datasets_root(), dirs_exist_ok=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shipped, "install", copied)
        yield


@pytest.fixture(autouse=True, scope="session")
def blank(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    """Figures of datasets and runs are a pixel where many are made: few are looked at.

    Returns what draws them, by its place.
    """
    places = ["datasets.card_figure.draw_card"]
    places += ["eval.figures.learning_curve", "eval.figures.online_curve"]
    drawing: dict[str, Any] = {}
    if any(item.get_closest_marker("slow") for item in request.session.items):
        drawing = {f"marl_mm.{p}": resolve_name(f"marl_mm.{p}") for p in places}
    with pytest.MonkeyPatch.context() as patch:
        for place in drawing:
            patch.setattr(
                place, lambda *given: Image.new("L", (1, 1)).save(given[-1], "png")
            )
        yield drawing


@pytest.fixture
def drawn(blank: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of datasets and runs are as a user has them."""
    for place, draw in blank.items():
        monkeypatch.setattr(place, draw)


@pytest.fixture
def registries() -> Iterator[None]:
    """Nothing stays registered, loaded or open after the test."""
    kinds: tuple[Registry[Any], ...] = (TASKS, ALGORITHMS, COLLECTORS, METRICS)
    names = "_things", "_origins", "_places"
    before = [(kind, kind.names()) for kind in kinds]
    kept = [{name: dict(getattr(kind, name)) for name in names} for kind in kinds]
    loaded, known = dict(plugins._loaded), dict(gymnasium.registry)
    modules, cores = set(sys.modules), set(replay._cores)
    yield
    for kind, parts in zip(kinds, kept, strict=True):
        for name, part in parts.items():
            setattr(kind, name, part)
    assert [(kind, kind.names()) for kind in kinds] == before
    restore(plugins._loaded, loaded)
    restore(gymnasium.registry, known)
    for name in set(sys.modules) - modules:
        if name.startswith("marl_mm_plugin_"):
            del sys.modules[name]
    for key in set(replay._cores) - cores:
        replay._cores.pop(key).close()


def restore(now: dict[str, Any], then: dict[str, Any]) -> None:
    now.clear()
    now.update(then)


@pytest.fixture(scope="session")
def limits() -> RobotLimits:
    return robot_limits(RobotConfig())


@pytest.fixture(scope="session")
def situation(limits: RobotLimits) -> Callable[[np.random.Generator], Situation]:
    """Draws a state near the initial posture with targets that ask for a lot."""
    robot = RobotConfig()
    model = RobotModel(robot)
    posture = np.array(robot.initial_joints)

    def draw(rng: np.random.Generator, spread: float = 0.4) -> Situation:
        yaw = rng.uniform(-np.pi, np.pi)
        joints = posture + rng.normal(0, spread, 7)
        joints = np.clip(joints, limits.lower + 0.05, limits.upper - 0.05)
        q = np.array([*rng.uniform(-1, 1, 2), np.cos(yaw), np.sin(yaw), *joints])
        base = [rng.uniform(-0.3, 0.3), 0.0, rng.uniform(-0.3, 0.3)]
        v = np.array([*base, *rng.normal(0, spread / 2, 7)])
        state = RobotState(q, v)
        terms = ModelTerms(*(array.copy(order="K") for array in model.evaluate(state)))
        reference = Reference(
            terms.position_w + rng.uniform(-0.15, 0.15, 3),
            np.ascontiguousarray(terms.rotation_w),
            q[:2] + rng.uniform(-0.05, 0.05, 2),
            yaw + rng.uniform(-0.2, 0.2),
            rng.uniform(-0.05, 0.05),
            posture,
        )
        return state, terms, reference

    return draw


@pytest.fixture
def core() -> Iterator[EpisodeCore]:
    core = EpisodeCore(make_task())
    yield core
    core.close()


@pytest.fixture(params=list(ENGINES))
def open_world(request: pytest.FixtureRequest) -> Iterator[OpenWorld]:
    """Builds the core of a task, perhaps with fewer steps and its load changed; closed
    after the test."""
    opened: list[EpisodeCore] = []

    def build(task: str, steps: int | None = None, **load: Any) -> EpisodeCore:
        overrides: dict[str, Any] = {"simulation": {"engine": request.param}}
        overrides |= {"max_steps": steps} if steps else {}
        overrides |= {"load": load} if load else {}
        opened.append(EpisodeCore(make_task(task, overrides)))
        return opened[-1]

    yield build
    for core in opened:
        core.close()


@pytest.fixture(scope="session")
def short_task() -> Task:
    """Reach with steps of a tenth of a second, for tests about everything else."""
    return make_task("Reach-v0", {"ticks_per_step": 24, "max_steps": 4})


def build_episode(
    index: int, steps: int = 3, success: bool = True, layout: Layout = REACH
) -> Episode:
    rng = np.random.default_rng(index)
    ends = np.arange(steps) == steps - 1
    goal_x = 1.2 if index % 2 else -0.6
    states = rng.normal(size=(steps + 1, len(layout.state)))
    states[:, layout.goal] = goal_x, 0.1, 0.6
    for place, entry in enumerate(layout.state):
        if (entry.low, entry.high) == (0.0, 1.0):  # such as whether a block is held
            states[:, place] = rng.integers(2, size=steps + 1)
    return Episode(
        states=states,
        actions=rng.uniform(0, 1, (steps, len(layout.action))).astype(np.float32),
        rewards=rng.normal(size=steps),
        terminated=ends & success,
        truncated=ends & (not success),
        info={key: rng.normal(size=steps) for key in INFO}
        | {"is_success": (ends & success).astype(float)},
        seed=100 + index,
        index=index,
        source="pd",
        start=rng.normal(size=11),
        layout=layout,
    )


@pytest.fixture(scope="session")
def make_episode() -> MakeEpisode:
    """Builds an episode of random numbers: index, steps, success, layout."""
    return build_episode


@pytest.fixture
def episodes() -> list[Episode]:
    return [build_episode(i, steps=3 + i % 3, success=i != 2) for i in range(6)]


@pytest.fixture(scope="session")
def workers_of() -> WorkersOf:
    """Worker processes of a command's process: below the server they are copies of."""

    def found(pid: int) -> list[psutil.Process]:
        command = psutil.Process(pid)
        direct = command.children()
        return [
            child for child in command.children(recursive=True) if child not in direct
        ]

    return found


@pytest.fixture
def datasets_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    return tmp_path / "datasets"
