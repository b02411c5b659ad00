"""A Ray cluster of two nodes collects the same bytes as one process."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from marl_mm.cli import main
from marl_mm.datasets.location import locate
from marl_mm.errors import UsageError, WorkerDiedError

ray = pytest.importorskip("ray")
from ray.cluster_utils import Cluster  # noqa: E402

from marl_mm.ray_workers import RayWorkers  # noqa: E402


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()


_offset = 0


def set_offset(value: int) -> None:
    global _offset
    _offset = value


def shifted(value: int) -> int:
    if value < 0:
        raise UsageError(f"{value} is negative")
    return value + _offset


def node(_: int) -> str:
    return str(ray.get_runtime_context().get_node_id())


@pytest.mark.slow
def test_order_errors_and_both_nodes(cluster: Any) -> None:
    with RayWorkers(2, set_offset, (10,)) as pool:
        assert list(pool.map(shifted, range(30))) == [i + 10 for i in range(30)]
        assert sorted(pool.completed(shifted, range(9))) == list(range(10, 19))
        assert len(set(pool.map(node, range(10)))) == 2
        with pytest.raises(UsageError, match="-1 is negative"):
            list(pool.map(shifted, [1, -1]))
    with pytest.raises(UsageError, match="the Ray cluster has 2 CPUs"):
        RayWorkers(5, set_offset, (10,))


def die(_: int) -> None:
    import os

    os._exit(3)


@pytest.mark.slow
def test_a_dead_worker_is_named(cluster: Any) -> None:
    with RayWorkers(1, set_offset, (1,)) as pool:
        with pytest.raises(WorkerDiedError, match="a Ray worker died"):
            list(pool.map(die, [1]))


@pytest.mark.slow
def test_a_cluster_collects_the_same_bytes(cluster: Any, datasets_home: Path) -> None:
    words = ["collect", "pretrained", "--steps", "40", "--engine", "mujoco"]
    assert main([*words, "--dataset", "x", "--workers", "1"]) == 0
    files = [locate("x").data / name for name in ("main_data.hdf5", "metadata.json")]
    here = [file.read_bytes() for file in files]
    ray_words = ["--executor", "ray", "--workers", "2", "--overwrite"]
    assert main([*words, "--dataset", "x", *ray_words]) == 0
    assert [file.read_bytes() for file in files] == here
    assert main([*words, "--dataset", "y", "--executor", "ray", "--workers", "9"]) == 2


@pytest.mark.slow
def test_a_cluster_trains_the_same_study(cluster: Any, tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from marl_mm.eval.studies import Setting, Study\n"
        'SMALL = Study("Small.", [("good-5k", Setting("own", "own"))])\n'
    )
    words = ["ablate", f"{own}:SMALL", "--budget", "smoke", "--seeds", "0", "1"]
    assert main([*words, "--runs", str(tmp_path / "here"), "--workers", "1"]) == 0
    distant = ["--runs", str(tmp_path / "there"), "--executor", "ray"]
    assert main([*words, *distant, "--workers", "2"]) == 0
    here, there = (tmp_path / name / "results" for name in ("here", "there"))
    for file in ("small.csv", "rows/good-5k/own.csv.xz", "rows/good-5k/own.json"):
        assert (here / file).read_bytes() == (there / file).read_bytes()
