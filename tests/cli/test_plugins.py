"""Plug-ins: the examples work from everywhere, and what is not trusted is not run."""

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm import plugins
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.cli import main
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.dataset import load_dataset
from marl_mm.envs import make_task, make_vec, parallel_env
from marl_mm.envs.registry import TASKS
from marl_mm.errors import PluginError, UsageError
from marl_mm.eval.evaluate import evaluate
from tests.forks import Fork

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"

FEW = ["--eval-episodes", "2", "--curve-episodes", "1", "--workers", "1"]
SMALL = [*FEW, "--updates", "20", "--curve-every", "20", "--hidden", "8"]
SMALL += ["--max-steps", "2", "--engine", "mujoco"]  # the faster one


pytestmark = pytest.mark.usefixtures("registries")


def run(*words: object) -> int:
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)


def plugged(*names: str) -> list[object]:
    return [word for name in names for word in ("--plugin", EXAMPLES / f"{name}.py")]


# --- An algorithm ------------------------------------------------------------


@pytest.mark.slow
def test_an_algorithm_of_ones_own_is_trained_resumed_evaluated_and_exported(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, awac = tmp_path / "awac", plugged("awac")
    train = ["train", "awac", "--dataset", "good-5k", *SMALL, *awac, "--seeds", 0, 1]
    assert run(*train, "--out", out) == 0
    config = json.loads((out / "0" / "config.json").read_text())
    assert (
        list(config["plugins"]) == ["awac.py"]
        and len(config["plugins"]["awac.py"]) == 64
    )
    assert run(*train, "--out", tmp_path / "whole", "--updates", 40) == 0
    assert run(*train, "--out", out, "--updates", 40, "--resume") == 0
    for seed in ("0", "1"):
        went_on, whole = (read_checkpoint(p / seed) for p in (out, tmp_path / "whole"))
        for name, value in whole["state"]["actors"]["joint"].items():
            assert torch.equal(value, went_on["state"]["actors"]["joint"][name])
    capsys.readouterr()
    # Acting needs no plug-in; going on does.
    assert (
        run("eval", out / "0", "--episodes", 2, "--workers", 1, "--max-steps", 2) == 0
    )
    assert run("export", out / "0", "--out", tmp_path / "p.ts") == 0
    assert run("play", out / "0", "--max-steps", 1, "--video", tmp_path / "x.gif") == 0


@pytest.mark.slow
def test_seeds_in_processes_of_their_own_find_the_plugin(
    datasets_home: Path, tmp_path: Path
) -> None:
    train = ["train", "awac", "--dataset", "good-5k", *SMALL, *plugged("awac")]
    first, second = tmp_path / "one", tmp_path / "two"
    assert run(*train, "--seeds", 0, 1, "--out", first) == 0
    assert run(*train, "--seeds", 0, 1, "--out", second, "--workers", 2) == 0
    for seed in ("0", "1"):
        here, there = (load_policy(path / seed) for path in (first, second))
        assert here.fingerprint == there.fingerprint


@pytest.mark.slow
def test_a_changed_plugin_is_refused_unless_allowed(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = Path(shutil.copy(EXAMPLES / "awac.py", tmp_path / "awac.py"))
    words = ["train", "awac", "--dataset", "good-5k", *SMALL, "--out", tmp_path / "r"]

    def fresh(*more: object) -> tuple[int, str]:
        """In a process of its own, as a changed file needs."""
        with Fork(*words, *more) as job:
            return job.wait(), job.complaint

    assert run(*words, "--plugin", mine) == 0
    further = ["--updates", "40", "--resume"]
    renamed = Path(shutil.copy(mine, tmp_path / "same.py"))
    both = "--plugin", renamed, "--plugin", mine
    code, complaint = fresh("--updates", "30", "--resume", *both)
    assert code == 0, complaint
    code, complaint = fresh(*further)
    assert code == 2 and "--plugin" in complaint
    mine.write_text(mine.read_text() + "\n# changed\n")
    code, complaint = fresh(*further, "--plugin", mine)
    assert code == 2 and "was made with another awac.py" in complaint, complaint
    assert "--allow-changed-plugin" in complaint
    code, complaint = fresh(*further, "--plugin", mine, "--allow-changed-plugin")
    assert code == 0, complaint
    config = json.loads((tmp_path / "r" / "0" / "config.json").read_text())
    *_, before = config["plugins_before"]
    assert before["same.py"] != config["plugins"]["awac.py"]


@pytest.mark.slow
def test_a_study_of_two_settings_with_an_algorithm_of_ones_own(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Declared in a file that names the plug-in itself, run in two processes."""
    shutil.copy(EXAMPLES / "awac.py", tmp_path)
    (tmp_path / "study.py").write_text(
        "from pathlib import Path\n"
        "from marl_mm.eval.studies import Setting, Study\n"
        "from marl_mm.plugins import load\n"
        'load(Path(__file__).with_name("awac.py"))\n'
        'few = {"updates": 20, "hidden": (8,)}\n'
        'settings = Setting("own", "AWAC", "awac", changes=few, goals=2),\\\n'
        '    Setting("clone", "MABC", "mabc", changes=few, goals=2)\n'
        'MINE = Study("Mine", [("marl_mm/reach/good-5k-v0", s) for s in settings])\n'
    )
    words = ["ablate", f"{tmp_path / 'study.py'}:MINE", "--budget", "smoke"]
    words += ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "results")]
    assert run(*words, "--seeds", 0, "--workers", 2, "--json") == 0
    (table,) = json.loads(capsys.readouterr().out).values()
    assert len(table) == 2


# --- Tasks -------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plugin", "task", "collector"),
    [
        ("timed_reach", "TimedReach-v0", "pd"),
        ("three_agents", "ThreeReach-v0", "scripted"),
    ],
)
def test_a_task_of_ones_own_goes_through_everything(
    plugin: str,
    task: str,
    collector: str,
    datasets_home: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    own, data = plugged(plugin), str(tmp_path / "data-v0")
    collect = ["collect", collector, "--task", task, "--steps", 12, "--dataset", data]
    faster = "--engine", "mujoco"
    assert run(*collect, "--workers", 2, *own, *faster) == 0
    assert run("datasets", "show", data) == 0
    assert run("datasets", "verify", data, "--replay", *own) == 0
    plugins.load(EXAMPLES / f"{plugin}.py")
    layout = make_task(task).layout
    assert load_dataset(data).arrays.layout == layout
    for algorithm in ("mabc", "td3-bc"):
        out = tmp_path / algorithm
        train = ["train", algorithm, "--dataset", data, "--out", out, *SMALL]
        assert run(*train, *own) == 0
        policy = load_policy(out / "0")
        assert policy.layout == layout
        assert run("export", out / "0") == 0
        evaluation = evaluate(policy, 2, task=task, overrides={"max_steps": 2})
        assert len(evaluation.rows) == 2
    online = ["train", "maddpg-her", "--task", task, "--episodes", 2, "--warm-up", 2]
    few = ["--updates-per-episode", 2, "--max-steps", 2, "--hidden", 8, *FEW, *own]
    assert run(*online, *few, *faster, "--out", tmp_path / "online") == 0
    env = parallel_env(task)
    observations, _ = env.reset(seed=0)
    mabc = load_policy(tmp_path / "mabc" / "0")
    actions = mabc.act_agents(observations)
    assert {n: a.shape for n, a in actions.items()} == {
        agent.name: (len(agent.sets),) for agent in layout.team
    }
    env.step(actions)
    env.close()


@pytest.mark.slow
@pytest.mark.bullet
def test_two_layouts_of_equal_width_never_pass_for_each_other(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Data, runs and films of one are refused where the other is meant, before the
    first step, by the entries that differ."""
    own = plugged("timed_reach")
    data: dict[str, str] = {}
    for task in ("TimedReach-v0", "PacedReach-v0"):
        data[task] = str(tmp_path / f"{task[:-3]}-v0")
        words: list[object] = ["collect", "pd", "--task", task, "--steps", "8"]
        words += ["--dataset", data[task], "--engine", "mujoco"]
        assert run(*words, "--workers", 1, *own) == 0
    train = ["train", "mabc", "--dataset", data["TimedReach-v0"], *SMALL, *own]
    assert run(*train, "--out", tmp_path / "run") == 0
    capsys.readouterr()
    other = ["--task", "PacedReach-v0", *own]
    refused = [
        ["eval", tmp_path / "run/0", "--episodes", 2, "--workers", 1, *other],
        ["play", tmp_path / "run/0", "--video", tmp_path / "x.gif", *other],
        [*train, "--task", "PacedReach-v0", "--out", tmp_path / "other"],
        ["collect", "pretrained", "--agent", tmp_path / "run/0", "--steps", 4,
         "--workers", 1, "--dataset", tmp_path / "y-v0", *other],
    ]  # fmt: skip
    for refusal in refused:
        assert run(*refusal) == 2, refusal
        complaint = capsys.readouterr().err.splitlines()[-1]
        assert "state time_left" in complaint and "state tempo" in complaint
    assert not (tmp_path / "x.gif").exists() and not (tmp_path / "other").exists()
    mixed = [
        "datasets",
        "mix",
        f"{data['TimedReach-v0']}:4",
        f"{data['PacedReach-v0']}:4",
    ]
    assert run(*mixed, "--out", tmp_path / "both-v0") == 2
    sources: list[object] = [data["TimedReach-v0"]]
    for form in ("flat", "agents"):
        sources.append(tmp_path / f"{form}.hdf5")
        export = ["datasets", "export", data["TimedReach-v0"], "--layout", form]
        assert run(*export, "--out", sources[-1], *own) == 0
    for number, source in enumerate(sources):
        words = ["datasets", "import", source, "--out", tmp_path / f"z{number}-v0"]
        capsys.readouterr()
        assert run(*words, *other) == 2, source
        complaint = capsys.readouterr().err
        assert "state time_left" in complaint and "state tempo" in complaint
        assert run(*words, "--task", "TimedReach-v0", *own) == 0


def test_a_joint_policy_acts_for_another_team(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["eval", "pretrained", "--episodes", 2, "--max-steps", 2, "--workers", 1]
    assert run(*words, "--task", "ThreeReach-v0", *plugged("three_agents")) == 0


# --- A collector -------------------------------------------------------------


@pytest.mark.slow
def test_a_collector_of_ones_own_collects_replays_and_plays(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = plugged("noisy_pd")
    words = [
        "collect",
        "noisy-pd",
        "--steps",
        30,
        "--max-steps",
        6,
        "--noise",
        0.5,
        *own,
    ]
    for workers, name in ((1, "one-v0"), (2, "two-v0")):
        where = ["--dataset", tmp_path / name, "--workers", workers]
        assert run(*words, *where) == 0
    first, second = (load_dataset(tmp_path / name) for name in ("one-v0", "two-v0"))
    assert first.fingerprint == second.fingerprint
    assert list(first.provenance.own_origin.plugins) == ["noisy_pd.py"]
    assert run("datasets", "verify", tmp_path / "one-v0", "--replay") == 0
    more = ["--dataset", tmp_path / "one-v0", "--workers", 1, "--resume"]
    assert run("collect", "noisy-pd", "--steps", 40, *more, *own) == 0
    assert load_dataset(tmp_path / "one-v0").arrays.steps >= 40
    few = ["--episodes", 2, "--max-steps", 2, "--workers", 1]
    assert run("eval", "noisy-pd", *few, "--noisy-pd.noise", 1.0, *own) == 0


# --- From Python -------------------------------------------------------------


def test_from_python_a_plugin_is_loaded_or_registered() -> None:
    plugin = plugins.load(EXAMPLES / "timed_reach.py")
    assert plugins.load(EXAMPLES / "timed_reach.py") is plugin
    assert str(EXAMPLES) not in sys.path
    assert (plugin.name, len(plugin.sha256)) == ("timed_reach.py", 64)
    assert TASKS.origin("TimedReach-v0") == "timed_reach.py"
    assert plugins.record("timed_reach.py", "marl_mm") == {plugin.name: plugin.sha256}
    task, pd = make_task("TimedReach-v0"), COLLECTORS.get("pd")
    policy = pd.policy(pd.config(), task)
    result = evaluate(policy, 2, task="TimedReach-v0", overrides={"max_steps": 2})
    assert len(result.rows) == 2 and {row["direction"] for row in result.rows} == {
        "forward",
        "backward",
    }


def test_a_file_that_changes_after_it_was_loaded_is_told(tmp_path: Path) -> None:
    """Workers would run other code than this process."""
    file = tmp_path / "mine.py"
    shutil.copy(EXAMPLES / "timed_reach.py", file)
    plugins.load(file)
    for change in (lambda: file.write_text("BROKEN = "), file.unlink):
        change()
        with pytest.raises((PluginError, UsageError), match=r"mine\.py"):
            plugins.load(file)
        with pytest.raises(PluginError, match=r"mine\.py has changed, or is gone"):
            make_vec("Reach-v0", 2, 2, backend="processes").reset(seed=0)


def test_a_file_that_changes_while_it_runs_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "itself.py"
    file.write_text("open(__file__, 'a').write('# saved')")
    plugins.load(file)
    with pytest.raises(PluginError, match=r"itself\.py has changed, or is gone"):
        plugins.load(file)


@pytest.mark.slow
def test_what_a_script_registers_works_in_workers(tmp_path: Path) -> None:
    """A guarded script of one's own, which workers import as their main module."""
    script = tmp_path / "mine.py"
    script.write_text(
        "from marl_mm.envs import make_task, register_task\n"
        "from marl_mm.envs.tasks.reach import Reach\n"
        "from marl_mm.collectors.random import RandomConfig, RandomPolicy\n"
        "from marl_mm.eval.evaluate import evaluate\n"
        "class Mine(Reach):\n    pass\n"
        "register_task('Mine-v0', Mine(max_steps=2))\n"
        "if __name__ == '__main__':\n"
        "    policy = RandomPolicy(RandomConfig())\n"
        "    print(len(evaluate(policy, 4, task='Mine-v0', workers=2).rows))\n"
    )
    process = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False
    )
    assert process.stdout == "4\n", process.stderr


# --- Mistakes ----------------------------------------------------------------


def test_plugins_that_are_none_or_fail_are_told_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("x = 1\nraise KeyError('oh')\n")
    (tmp_path / "syntax.py").write_text("def f(:\n")
    (tmp_path / "taken.py").write_text(
        "from marl_mm.envs import register_task\n"
        "from marl_mm.envs.tasks.reach import Reach\n"
        "register_task('Reach-v0', Reach())\n"
    )
    other = tmp_path / "other"
    other.mkdir()
    (other / "awac.py").write_text((EXAMPLES / "awac.py").read_text() + "\n# changed\n")
    for name in ("a-b.py", "a_b.py"):
        (other / name).write_text(f"# {name}")
    (tmp_path / "loop.py").symlink_to(tmp_path / "loop.py")
    (tmp_path / "quits.py").write_text("import sys\nsys.exit(0)\n")
    leave = sys.exit
    # As packages do that want to know how a process ends.
    monkeypatch.setattr(sys, "exit", lambda code: leave(code))
    for code, words, message in (
        (2, ["--plugin", tmp_path / "no.py"], "no plug-in"),
        (
            2,
            ["--plugin", "no_such_module_at_all"],
            "no plug-in 'no_such_module_at_all'",
        ),
        (2, ["--plugin", tmp_path / "loop.py"], "no plug-in"),
        (2, ["--plugin"], "--plugin has no value"),
        (2, ["--plugin", "--json"], "--plugin has no value"),
        (1, ["--plugin", broken], "broken.py fails: KeyError: 'oh' (line 2)"),
        (
            1,
            ["--plugin", tmp_path / "syntax.py"],
            "SyntaxError: invalid syntax (line 1)",
        ),
        (
            1,
            ["--plugin", tmp_path / "quits.py"],
            "quits.py fails: SystemExit: 0 (line 2",
        ),
        (2, ["--plugin", tmp_path], "expected FILE.py, or a module's name"),
        (1, ["--plugin", tmp_path / "taken.py"], "'Reach-v0' of taken.py exists alrea"),
        (
            2,
            [*plugged("awac"), "--plugin", other / "awac.py"],
            "two plug-ins are called",
        ),
        (
            1,
            ["--plugin", other / "a-b.py", "--plugin", other / "a_b.py"],
            "counts as the same plug-in",
        ),
    ):
        assert run("tasks", *words) == code, words
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line
    with pytest.raises(PluginError):
        plugins.load(broken)
    with pytest.raises(UsageError):
        plugins.load("")
    assert run("--plugin", EXAMPLES / "awac.py", "--help") == 0
    assert "usage: marl-mm COMMAND" in capsys.readouterr().out


def test_lists_tell_what_there_is_and_whose(capsys: pytest.CaptureFixture[str]) -> None:
    for kind, name, plugin in (
        ("algorithms", "awac", "awac"),
        ("tasks", "ThreeReach-v0", "three_agents"),
        ("collectors", "noisy-pd", "noisy_pd"),
    ):
        assert run(kind, "--json", *plugged(plugin)) == 0
        rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
        assert rows[name]["from"] == f"{plugin}.py"
        assert {row["from"] for row in rows.values()} == {"marl_mm", f"{plugin}.py"}
    for kind in ("formats", "metrics"):
        assert run(kind) == 0
    assert "[m]" in capsys.readouterr().out, "units are shown, not taken for markup"


def test_a_metric_is_checked_and_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "length.py"
    mine.write_text(
        "from marl_mm.eval.metrics import METRICS, Metric\n"
        "METRICS.add('length', Metric(about='steps', value=len, column='length'))\n"
    )
    assert run("check", mine) == 0
    eval_two = ["eval", "random", "--episodes", 2, "--max-steps", 1, "--workers", 1]
    capsys.readouterr()
    assert run(*eval_two, "--plugin", mine) == 0
    assert "length" in capsys.readouterr().out
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        "from marl_mm.eval.metrics import METRICS, Metric\n"
        "METRICS.add('way', Metric(about='x', value=lambda e: e.states[0]))\n"
    )
    assert run("check", wrong) == 1
    assert "fails  metric way" in capsys.readouterr().out
    assert run(*eval_two, "--plugin", wrong) == 1
    assert "metric 'way' is array" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.bullet
def test_nothing_in_a_file_loads_a_plugin(
    datasets_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names and paths of plug-ins in runs and data are told, never imported."""
    trap = tmp_path / "trap.py"
    trap.write_text("raise SystemExit('a file has run code')\n")
    monkeypatch.syspath_prepend(tmp_path)
    out = tmp_path / "run"
    assert run("train", "mabc", "--dataset", "good-5k", *SMALL, "--out", out) == 0
    config = json.loads((out / "0/config.json").read_text())
    config["plugins"] = {str(trap): "0" * 64}
    (out / "0/config.json").write_text(json.dumps(config))
    checkpoint = torch.load(out / "0" / FILE, weights_only=True)
    few = ["--episodes", 2, "--max-steps", 1, "--workers", 1]
    for name, code in ((str(trap), 1), (trap.stem, 0)):
        named = {"algorithm": name, "plugins": {str(trap): "0" * 64}}
        torch.save(checkpoint | named, out / "0" / FILE)
        assert run("eval", out / "0", *few) == code
    assert np.isfinite(load_policy(out / "0").act(np.zeros(10))).all()
    assert "trap.py" not in plugins._loaded


@pytest.mark.usefixtures("registries")
def test_the_hash_of_a_package_is_of_all_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    files = [tmp_path / f"packaged/{name}.py" for name in ("__init__", "in/__init__")]
    files.append(tmp_path / "packaged/inner.py")
    for number, file in enumerate(files):
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"NUMBER = {number}\n")
    try:
        plugin = plugins.load("packaged")
    finally:
        sys.modules.pop("packaged", None)
    code = b"".join(file.read_bytes() for file in sorted(files))
    assert plugin.sha256 == hashlib.sha256(code).hexdigest()
