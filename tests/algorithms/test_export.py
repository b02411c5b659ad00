"""Exported policies act as the run's do, without this package."""

import json
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import helper, numpy_helper

from marl_mm.algorithms.export import (
    TOLERANCE,
    export_policy,
    exported_metadata,
    largest_difference,
)
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import load_pretrained
from marl_mm.cli import main
from marl_mm.contracts.learners import (
    UNUSUAL,
    candidate,
    several_layouts,
    some_episodes,
)
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.errors import ExportError
from marl_mm.robot.model import RobotState

SMALL = (
    "mabc --dataset good-5k --engine mujoco --updates 100 --hidden 8 --curve-every 100 "
    "--curve-episodes 1 --eval-episodes 2 --workers 1 --max-steps 5"
).split()


@pytest.fixture(scope="module")
def mabc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        assert main(["train", *SMALL, "--out", str(folder / "run")]) == 0
    return folder / "run" / "0"


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    """Those of the dataset that ships."""
    states: np.ndarray = shipped_arrays().states[::7].astype(np.float32)
    return states


@pytest.mark.slow
def test_torchscript_acts_without_the_package(
    mabc: Path, states: np.ndarray, tmp_path: Path
) -> None:
    """In a process that cannot import it."""
    assert main(["export", str(mabc)]) == 0
    np.save(tmp_path / "states.npy", states)
    code = (
        "import sys, numpy as np, torch; sys.modules['marl_mm'] = None;"
        "policy = torch.jit.load(sys.argv[1]);"
        "states = torch.from_numpy(np.load('states.npy'));"
        "np.save('actions.npy', policy(states).detach().numpy())"
    )
    command = [sys.executable, "-c", code, str(mabc / "policy.ts")]
    subprocess.run(command, cwd=tmp_path, check=True)
    policy = load_policy(mabc)
    expected = [policy.act(state) for state in states]
    found = np.load(tmp_path / "actions.npy")
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


@pytest.mark.slow
def test_the_example_of_a_robots_loop_reaches_goals_and_stops(tmp_path: Path) -> None:
    """With the file of the agent that ships, ahead and behind; and after an error."""
    export_policy(load_pretrained(), tmp_path / "policy.ts", "torchscript")
    example = Path(__file__).resolve().parents[2] / "examples/robot_loop.py"
    loop = runpy.run_path(str(example))
    exported = loop["load"](str(tmp_path / "policy.ts"))
    for goal in ([1.2, 0.1, 0.7], [-0.6, -0.1, 0.6]):
        left = loop["reach"](exported, np.array(goal), loop["Robot"]())
        assert left < loop["TASK"].success_distance
    robot, stopped = loop["Robot"](), []
    robot.read = lambda: RobotState(np.full(11, np.nan), np.zeros(10))
    robot.stop = lambda: stopped.append(True)
    with pytest.raises(ValueError, match="is not finite"):
        loop["reach"](exported, np.array([1.2, 0.1, 0.7]), robot)
    assert stopped


def test_the_best_policy_has_a_file_of_its_own(mabc: Path) -> None:
    assert main(["export", str(mabc / "best.pt")]) == 0
    assert (mabc / "best-policy.ts").exists()


@pytest.mark.slow
def test_onnx_of_one_agent_acts_on_its_own_observation(
    mabc: Path, states: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--format", "onnx", "--agent", "balance", "--json"]
    assert main(["export", str(mabc), *words]) == 0
    exported = json.loads(capsys.readouterr().out)
    session = onnxruntime.InferenceSession(exported["file"])
    inside = json.loads(session.get_modelmeta().custom_metadata_map["marl_mm"])
    layout = REACH.agents[1]
    assert inside["observation"] == [REACH.state_names[i] for i in layout.observation]
    assert (inside["action"], inside["action_low"]) == (["alpha"], [0.0])
    own = states[:, list(layout.observation)]
    (found,) = session.run(None, {"observation": own})
    policy = load_policy(mabc)
    expected = [policy.act(state)[[3]] for state in states]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


@pytest.mark.slow
def test_a_joint_policy_as_onnx(states: np.ndarray, tmp_path: Path) -> None:
    policy = load_pretrained()
    exported = export_policy(policy, tmp_path / "p.onnx", "onnx")
    assert (exported["observation"], exported["action"]) == (
        list(REACH.state_names),
        list(REACH.action_names),
    )
    session = onnxruntime.InferenceSession(tmp_path / "p.onnx")
    (found,) = session.run(None, {"observation": states[:50]})
    expected = [policy.act(state) for state in states[:50]]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)
    model = onnx.load_model(tmp_path / "p.onnx")
    relu = next(node for node in model.graph.node if node.op_type == "Relu")
    relu.op_type = "Abs"
    onnx.save_model(model, tmp_path / "p.onnx")
    with pytest.raises(ExportError, match="its content is not what was written"):
        exported_metadata(tmp_path / "p.onnx")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["torchscript", "onnx"])
@pytest.mark.parametrize(
    "name", ["ma-flow-bc", "mac-flow", "q-chunking", "ma-q-chunking"]
)
def test_policies_that_draw_and_plan(name: str, form: str, tmp_path: Path) -> None:
    """Noise goes in beside observations; actions in a row come out of it."""
    tested = candidate(name)
    arrays = several_layouts(some_episodes())[UNUSUAL]
    policy = tested.policy(tested.trained(arrays))
    count, chunk = len(arrays.layout.action), getattr(tested.config, "chunk", 1)
    path = tmp_path / f"policy.{form}"
    exported = export_policy(policy, path, form)
    assert exported["noise"] == chunk * count
    assert exported.get("chunk", 1) == chunk
    states = arrays.states[:20].astype(np.float32)
    streams = [np.random.default_rng(row) for row in range(20)]
    noise = np.array([s.standard_normal(chunk * count, np.float32) for s in streams])
    if form == "onnx":
        session = onnxruntime.InferenceSession(path)
        (found,) = session.run(None, {"observation": states, "noise": noise})
    else:
        loaded = torch.jit.load(path)  # type: ignore[no-untyped-call]
        found = loaded(torch.from_numpy(states), torch.from_numpy(noise)).numpy()
    expected = np.empty((20, chunk, count), np.float32)
    for row, state in enumerate(states):
        policy.begin(np.random.default_rng(row), policy.layout)
        expected[row] = [policy.act(state) for _ in range(chunk)]
    np.testing.assert_allclose(found.reshape(20, chunk, -1), expected, atol=TOLERANCE)


def test_large_actions_may_differ_by_more() -> None:
    low, high = [-1000.0, 0.0], [1000.0, 1.0]
    metadata = {"action_low": low, "action_high": high}
    actions = np.array([[0.0, 0.5]])
    far, near = np.array([[0.005, 0.5]]), np.array([[0.0, 0.50001]])
    assert largest_difference(far, actions, metadata) == pytest.approx(5e-6)
    assert largest_difference(near, actions, metadata) == pytest.approx(2e-5)


def test_a_file_that_acts_otherwise_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load: Callable[[Path], Any] = torch.jit.load

    def spoilt(path: Path) -> Callable[[torch.Tensor], torch.Tensor]:
        policy: Callable[[torch.Tensor], torch.Tensor] = load(path)
        return lambda observations: policy(observations) + 0.1

    monkeypatch.setattr(torch.jit, "load", spoilt)
    with pytest.raises(ExportError, match="differ from the run's by"):
        export_policy(load_pretrained(), tmp_path / "p.ts", "torchscript")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "no checkpoint at nowhere"),
        (["pretrained", "--agent", "balance"], "no agent 'balance', expected joint"),
        (["pretrained", "--out", "."], "is a folder, expected a file"),
        (["pretrained", "--out", "p.onnx"], "p.onnx, expected a file that ends in .ts"),
    ],
)
def test_bad_requests(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", *words]) == 2
    assert message in capsys.readouterr().err


def test_weights_that_lie_beside_the_file_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where onnx would find them: no checksum is of what they are."""
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", 2])
        for name in ("observation", "action")
    ]
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    weights = numpy_helper.from_array(np.eye(2, dtype=np.float32), "w")
    graph = helper.make_graph([node], "policy", ends[:1], ends[1:], [weights])
    model = helper.make_model(graph)
    helper.set_model_props(model, {"marl_mm": "{}"})
    monkeypatch.chdir(tmp_path)
    onnx.save_model(
        model,
        "p.onnx",
        save_as_external_data=True,
        location="w.bin",
        size_threshold=0,
    )
    with pytest.raises(ExportError, match="weights in other files"):
        exported_metadata(tmp_path / "p.onnx")
