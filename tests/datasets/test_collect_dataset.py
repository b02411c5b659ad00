"""Collecting with the real command, stopped in every way, gives the same bytes."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil
import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.collectors.collect import collect
from marl_mm.collectors.medium import MediumConfig, MediumPolicy
from marl_mm.collectors.pd import PdConfig
from marl_mm.collectors.pretrained import PretrainedConfig, PretrainedPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import everything
from marl_mm.commands import collect as command
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import FILE, Journal, begun
from marl_mm.datasets.location import Location, locate
from marl_mm.envs.rollout import EpisodePlan
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.files import only_here
from marl_mm.policy import Policy
from marl_mm.runs import collecting
from marl_mm.runs.collecting import Collecting, _Collector, collect_dataset
from marl_mm.runs.paper import PAPER
from marl_mm.runs.sources import Mix
from marl_mm.versions import versions
from tests.forks import Fork

WorkersOf = Callable[[int], list[psutil.Process]]
MakeEpisode = Callable[..., Episode]
STEPS = 120
"""Of random data: five episodes."""


def data(name: str) -> bytes:
    """All bytes of a dataset: its episodes, and what it says of itself."""
    files = ("main_data.hdf5", "metadata.json")
    return b"".join((locate(name).data / file).read_bytes() for file in files)


def collecting_fork(name: str, workers: int, *options: str) -> Fork:
    """The command in a process of its own, collecting random data."""
    words = ["collect", "random", "--steps", STEPS, "--dataset", name]
    return Fork(*words, "--workers", workers, *options)


def journal_holds(location: Location, episodes: int) -> None:
    """Wait until a collection has finished so many."""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        # Only read: a journal that is opened to write here may have its tables made
        # in the moment in which the collection makes them.
        if (begun().get(location.id) or 0) >= episodes:
            return
        time.sleep(0.05)
    raise AssertionError("nothing was collected in two minutes")


QUICKLY = ["--workers", "1", "--engine", "mujoco"]
"""Where nothing is stopped while it simulates."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """An uninterrupted collection, elsewhere."""
    return collected(tmp_path_factory, "--workers", "1")


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The same on the faster engine."""
    return collected(tmp_path_factory, *QUICKLY)


def collected(tmp_path_factory: pytest.TempPathFactory, *options: str) -> bytes:
    words = ["collect", "random", "--steps", str(STEPS), *options]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("whole")))
        assert main([*words, "--dataset", "marl_mm/reach/test-v0"]) == 0
        return data("marl_mm/reach/test-v0")


@pytest.mark.slow
def test_killed_parents_and_workers_cost_nothing_finished(
    datasets_home: Path,
    whole: bytes,
    workers_of: WorkersOf,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """kill -9 of the command, then of a worker; then --resume, to the same bytes."""
    name = "marl_mm/reach/test-v0"
    location = locate(name)
    with collecting_fork(name, 2) as first:
        journal_holds(location, 1)
        workers = workers_of(first.pid)
        assert len(workers) == 2
    _, alive = psutil.wait_procs(workers, timeout=20)
    assert not alive, "a worker outlived its parent"
    assert not location.folder.exists()
    with Journal(location.working) as journal:
        finished = len(journal.episodes(REACH))
    assert finished >= 1

    words = ["collect", "random", "--steps", str(STEPS), "--dataset", name]
    assert main(words) == 2  # not overwritten, not resumed unasked
    assert "was begun already; go on with --resume" in capsys.readouterr().err

    with collecting_fork(name, 2, "--resume") as second:
        journal_holds(location, min(finished + 1, 4))
        workers_of(second.pid)[0].kill()
        assert second.wait() == 1
        complaint = second.complaint
    assert "a worker process died" in complaint and "--resume" in complaint
    assert "Traceback" not in complaint

    assert main([*words, "--resume", "--workers", "2"]) == 0
    assert data(name) == whole
    assert not location.working.exists()
    assert main(["datasets", "verify", name]) == 0


@pytest.mark.slow
def test_a_second_writer_is_refused_and_changes_nothing(
    datasets_home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "marl_mm/reach/test-v0"
    location = locate(name)
    assert main(["collect", "random", "--steps", "10", "--dataset", name]) == 0
    before = data(name)
    with only_here(location.working):
        words = ["collect", "random", "--dataset", name, "--overwrite"]
        assert main(words) == 2
        assert "another process is writing" in capsys.readouterr().err
    assert data(name) == before


@pytest.mark.slow
def test_a_killed_overwrite_goes_on_and_never_keeps_the_old(
    datasets_home: Path, whole: bytes
) -> None:
    """Also where the new one is of the same seed: code or packages may have changed."""
    name = "marl_mm/reach/test-v0"
    location = locate(name)
    words = ["collect", "random", "--dataset", name, "--workers", "1"]
    assert main([*words, "--steps", "30"]) == 0
    before = data(name)
    with collecting_fork(name, 1, "--overwrite"):
        journal_holds(location, 2)
    assert data(name) == before
    assert main([*words, "--steps", "30", "--resume"]) == 2  # fewer than asked for
    assert main([*words, "--resume"]) == 0  # as many as asked for
    assert data(name) == whole


KILLED = """
import os, shutil, signal, sys
from importlib import import_module
from marl_mm.cli import main

def killed(*words, **options):
    os.kill(os.getpid(), signal.SIGKILL)

module, name = sys.argv.pop().split(":")
module = import_module(module)
setattr(module, name, killed)
main(sys.argv[1:])
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "moment",
    [
        "marl_mm.datasets.storage:sign_metadata",  # the data are written
        "marl_mm.files:_exchange",  # all is written
        "marl_mm.runs.collecting:clear",  # it stands in its place
    ],
)
def test_killed_while_the_dataset_is_written(
    datasets_home: Path, quick: bytes, moment: str
) -> None:
    """Over a shorter dataset: there is always one of the two, and resuming ends it."""
    name = "marl_mm/reach/test-v0"
    words = ["collect", "random", "--dataset", name, *QUICKLY]
    assert main([*words, "--steps", "30"]) == 0
    before = data(name)
    more = [*words, "--steps", str(STEPS), "--resume"]
    with Fork(*more, moment, code=KILLED) as killed:
        assert killed.wait() == -9
    assert data(name) == (quick if moment.endswith("clear") else before)
    load_dataset(name)
    assert main([*words, "--resume"]) == 0  # as many as were asked for last
    assert data(name) == quick
    location = locate(name)
    assert not location.working.exists()
    left = {path.name for path in location.folder.parent.iterdir()}
    assert left == {"namespace_metadata.json", location.folder.name}


def test_a_collection_that_begins_as_another_ends_keeps_its_journal(
    datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clear = collecting.clear

    def clear_and_begin(location: Location) -> None:
        clear(location)
        Journal(location.working).__exit__()

    monkeypatch.setattr(collecting, "clear", clear_and_begin)
    marl_mm.collect("random", dataset="marl_mm/reach/test-v0", steps=1, max_steps=1)
    assert (locate("marl_mm/reach/test-v0").working / FILE).exists()


@pytest.mark.slow
def test_resuming_takes_what_is_left_out_from_the_collection(
    datasets_home: Path,
) -> None:
    name = "marl_mm/smooth-reach/test-v0"
    words = ["collect", "pd", "--dataset", name, "--task", "SmoothReach-v0"]
    words += ["--seed", "3", "--max-steps", "40", "--kd", "0.5", "--workers", "1"]
    words += ["--engine", "mujoco"]
    assert main([*words, "--steps", "30"]) == 0
    assert main(["collect", "pd", "--dataset", name, "--steps", "50", "--resume"]) == 0
    resumed = load_dataset(name)
    ours = resumed.metadata["marl_mm"]
    assert ours["task"] == "SmoothReach-v0" and ours["seed"] == 3
    simulation = {"engine": "mujoco"}
    assert ours["overrides"] == {"max_steps": 40, "simulation": simulation}
    assert ours["collector_config"]["kd"] == 0.5 and ours["steps"] >= 50
    content = data(name)
    assert main([*words, "--steps", "50", "--overwrite"]) == 0
    assert data(name) == content
    words = ["collect", "pd", "--dataset", name, "--steps", "60", "--resume"]
    assert main([*words, "--kd", "0.7"]) == 2


def test_a_refused_overwrite_keeps_what_was_begun(
    datasets_home: Path, make_episode: MakeEpisode
) -> None:
    location = locate("begun")
    with Journal(location.working) as journal:
        journal.begin({"task": "Reach-v0", "seed": 3})
        journal.add(make_episode(0))
    for workers in (0, 10_000):
        with pytest.raises(UsageError, match="workers"):
            marl_mm.collect("pd", dataset="begun", overwrite=True, workers=workers)
    with Journal(location.working) as journal:
        assert len(journal) == 1


@pytest.mark.slow
def test_a_hopeless_collector_leaves_nothing(
    datasets_home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["collect", "pd", "--kp", "0", "--max-steps", "1", "--dataset", "x"]
    assert main([*words, "--engine", "mujoco"]) == 1
    assert "reached no goal in 200 episodes in a row" in capsys.readouterr().err
    assert not [path for path in datasets_home.rglob("*") if path.is_file()]


@pytest.mark.slow
def test_a_longer_dataset_goes_on_from_the_shorter(
    datasets_home: Path, quick: bytes
) -> None:
    name = "marl_mm/reach/test-v0"
    words = ["collect", "random", "--dataset", name, *QUICKLY]
    assert main([*words, "--steps", "30"]) == 0
    assert main([*words, "--steps", str(STEPS), "--resume"]) == 0
    assert data(name) == quick
    assert main([*words, "--steps", str(STEPS), "--resume"]) == 0  # nothing to do
    assert main([*words, "--steps", "30", "--resume"]) == 2
    assert main([*words, "--steps", str(STEPS), "--resume", "--seed", "1"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("room", [30_000, 70_000])
def test_a_full_disk_ends_with_one_line_and_a_resumable_collection(
    datasets_home: Path, quick: bytes, room: int
) -> None:
    """The operating system lets no file grow further, then does.

    There is room for some episodes, or for all of them but not for the dataset.
    """
    name = "marl_mm/reach/test-v0"
    code = (
        "import resource, signal, sys; from marl_mm.cli import main;"
        "import marl_mm.commands.collect;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "room = int(sys.argv.pop());"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (room, room));"
        "sys.exit(main(sys.argv[1:]))"
    )
    words = ["collect", "random", "--steps", str(STEPS), "--dataset", name, *QUICKLY]
    with Fork(*words, room, code=code) as full:
        assert full.wait() == 1, full.complaint
        assert "Traceback" not in full.complaint and "--resume" in full.complaint
    assert not locate(name).folder.exists()
    assert main([*words, "--resume"]) == 0
    assert data(name) == quick


def test_nothing_to_resume_is_a_usage_error(datasets_home: Path) -> None:
    options = Collecting(steps=5, workers=1, resume=True)
    location = locate("marl_mm/reach/test-v0")
    for left in (False, True):
        if left:  # by a process that was killed while it wrote something else
            location.working.mkdir(parents=True)
        with pytest.raises(UsageError, match="nothing was begun"):
            collect_dataset(location, "random", RandomConfig(), options)
    assert not location.folder.exists()


def test_another_seed_does_not_go_on(
    datasets_home: Path, make_episode: MakeEpisode
) -> None:
    location = locate("marl_mm/reach/test-v0")
    with Journal(location.working) as journal:
        journal.begin({"task": "Reach-v0", "seed": 3})
        journal.add(make_episode(0))
    options = Collecting(steps=5, workers=1, resume=True)
    with pytest.raises(OtherConfigError, match=r"seed = 3 \(now 0\)"):
        collect_dataset(location, "random", RandomConfig(), options)


def test_what_is_asked_for_counts_when_python_goes_on(tmp_path: Path) -> None:
    """The rest is as it was begun."""
    data = tmp_path / "data"
    began: dict[str, Any] = {"dataset": data, "alpha": 0.5, "engine": "mujoco"}
    marl_mm.collect("pd", steps=8, seed=3, task="SmoothReach-v0", **began)
    again: dict[str, Any] = {"dataset": data, "steps": 20, "resume": True}
    for asked in ({"task": "Reach-v0"}, {"config": PdConfig(alpha=0.7)}, {"seed": 4}):
        with pytest.raises(OtherConfigError):
            marl_mm.collect("pd", **again | asked)
    more = marl_mm.collect("pd", **again)
    assert more.arrays.steps >= 20 and more.provenance.task == "SmoothReach-v0"


def test_episodes_of_other_versions_are_not_taken_for_those_of_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the collection was stopped, or is to be longer."""
    made: dict[str, Any] = {"dataset": tmp_path / "data", "workers": 1}
    marl_mm.collect("random", steps=5, max_steps=5, engine="mujoco", **made)
    now = versions()
    monkeypatch.setattr(collecting, "versions", lambda: now | {"numpy": "9.9.9"})
    for steps in (10, 15):
        more = marl_mm.collect("random", steps=steps, resume=True, **made)
        assert more.provenance.packages is not None
        both = {**more.provenance.packages}
        assert both.pop("numpy") == f"{now['numpy']}, 9.9.9"
        assert both.items() <= now.items()
    location = locate(str(tmp_path / "stopped"))
    options = Collecting(steps=5, max_steps=5, workers=1, resume=True, engine="mujoco")
    with Journal(location.working) as journal:
        work = _Collector(location, "random", RandomConfig(), options)
        journal.begin(work.about.to_json() | {"packages": now | {"numpy": "1.0"}})
    collect_dataset(location, "random", RandomConfig(), options)
    packages = load_dataset(location).provenance.packages
    assert packages is not None and packages["numpy"] == "1.0, 9.9.9"


def test_another_agent_does_not_go_on(
    datasets_home: Path, make_episode: MakeEpisode
) -> None:
    """The same path may hold other weights by now."""
    location = locate("x")
    options = Collecting(steps=5, workers=1, resume=True)
    with Journal(location.working) as journal:
        work = _Collector(location, "pretrained", PretrainedConfig(), options)
        journal.begin(work.about.to_json() | {"weights": "others"})
        journal.add(make_episode(0))
    with pytest.raises(OtherConfigError, match="weights = others"):
        collect_dataset(location, "pretrained", PretrainedConfig(), options)


def test_medium_leaves_the_agent_something(datasets_home: Path) -> None:
    options = Collecting(steps=5, workers=1, max_steps=10)
    with pytest.raises(UsageError, match="expected fewer than an episode's 10"):
        collect_dataset(locate("x"), "medium", MediumConfig(), options)


def test_attempts_that_come_in_any_order_are_kept_in_theirs(
    make_episode: MakeEpisode,
) -> None:
    """Known, new, not kept; and each new one is safe before anything else happens."""
    safe: list[int] = []

    def backwards(policy: Policy, plans: Iterator[EpisodePlan]) -> Iterator[Episode]:
        while True:
            some = [next(plans) for _ in range(3)]
            for plan in reversed(some):
                yield make_episode(plan.index, steps=4)

    known = {1: make_episode(1, steps=4), 2: None}
    collection = collect(
        RandomPolicy(RandomConfig()),
        everything,
        backwards,  # type: ignore[arg-type]
        20,
        seed=0,
        earlier_attempts=known,
        keep_safe=lambda episode: safe.append(episode.index),
    )
    assert [episode.index for episode in collection.episodes] == [0, 1, 3, 4, 5]
    assert collection.attempts == 6
    assert not {1, 2} & set(safe)
    assert {0, 3, 4, 5} <= set(safe)


def test_medium_is_random_first_and_then_the_agent() -> None:
    medium = MediumPolicy(MediumConfig(random_steps=3))
    random = RandomPolicy(RandomConfig())
    agent = PretrainedPolicy(PretrainedConfig())
    for policy in (medium, random, agent):
        policy.begin(np.random.default_rng(5), REACH)
    state = np.array([0.6, 0, 0.6, 0, 0, 0, 0.5, 1.2, 0, 0.6])
    for step in range(5):
        expected = (random if step < 3 else agent).act(state)
        np.testing.assert_array_equal(medium.act(state), expected)


def test_noise_is_of_the_episode_and_clipped() -> None:
    state = np.array([0.6, 0, 0.6, 0, 0, 0, 0.5, 1.2, 0, 0.6])
    exact = PretrainedPolicy(PretrainedConfig())
    noisy = PretrainedPolicy(PretrainedConfig(noise=0.5))
    exact.begin(np.random.default_rng(0), REACH)
    seen = []
    for seed in (1, 1, 2):
        noisy.begin(np.random.default_rng(seed), REACH)
        seen.append(np.stack([noisy.act(state) for _ in range(200)]))
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (seen[0] != seen[2]).any()
    assert seen[0].min() >= -1 and seen[0][:, 3].min() >= 0 and seen[0].max() <= 1
    assert np.abs(seen[0] - exact.act(state)).mean() > 0.1


@pytest.mark.slow
def test_the_papers_datasets_in_small(
    datasets_home: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All seven; a second time nothing is done; 60k begins with 30k."""

    def faster(data: Any) -> Any:
        if isinstance(data, Mix):
            return replace(data, parts=[(faster(s), n) for s, n in data.parts])
        return replace(data, engine="mujoco", first=data.first and faster(data.first))

    monkeypatch.setattr(command, "PAPER", [*map(faster, PAPER)])
    words = ["collect", "paper", "--scale", "0.002"]
    assert main(words) == 0
    names = {path.name: path for path in (datasets_home / "marl_mm/reach").glob("*-v0")}
    assert len(names) == 7
    before = {name: data(f"marl_mm/reach/{name}") for name in names}
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    assert {name: data(f"marl_mm/reach/{name}") for name in names} == before
    short, long = load_dataset("good-30k").arrays, load_dataset("good-60k").arrays
    assert long.states[: len(short.states)].tobytes() == short.states.tobytes()
    mixed = load_dataset("mix-5k-random-5k-medium-20k-good").arrays
    steps = {
        str(source): int(mixed.lengths[mixed.sources == source].sum())
        for source in np.unique(mixed.sources)
    }
    assert 40 <= steps["pretrained"] < 65
    assert 10 <= steps["medium"] < 35 and 10 <= steps["random"] < 35
    assert main([*words, "--seed", "1"]) == 2  # nothing is replaced unasked
    assert main(["collect", "paper", "--scale", "0.001"]) == 2
    metadata = locate("good-30k").data / "metadata.json"
    metadata.write_text("damaged")
    assert main(words) == 1
    assert main([*words, "--overwrite"]) == 0  # what is whole stays
    assert {name: data(f"marl_mm/reach/{name}") for name in names} == before


def test_an_unwritable_folder_is_named() -> None:
    code = """
import os, sys
from marl_mm.collectors.random import RandomConfig
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.datasets.location import locate
from marl_mm.errors import UsageError
if os.geteuid() == 0:  # root may write anywhere
    os.setreuid(65534, 65534)
try:
    collect_dataset(
        locate(sys.argv[1]), "random", RandomConfig(), Collecting(steps=5)
    )
except UsageError as error:
    print(error)
"""
    with TemporaryDirectory() as name:
        outer = Path(name)
        outer.chmod(0o755)
        folder = outer / "theirs"
        folder.mkdir(mode=0o555)
        refused = subprocess.run(
            [sys.executable, "-c", code, str(folder / "x")],
            capture_output=True,
            text=True,
            check=False,
        )
        assert f"{folder} is no folder open to you" in refused.stdout, refused.stderr
        assert list(folder.iterdir()) == []
