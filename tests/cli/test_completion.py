"""Completion in bash: commands, subcommands, options and their choices."""

import subprocess
from pathlib import Path

import pytest

from marl_mm.cli import COMMANDS, COMPLETION, LISTS, main

pytestmark = pytest.mark.slow  # every command is imported


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from marl_mm.commands.completion import script

    path = tmp_path_factory.mktemp("bash") / "marl-mm"
    path.write_text(script())
    return path


def completed(script: Path, line: str) -> list[str]:
    """What bash offers for the last word of a line."""
    words = line.split(" ")
    code = f"""
        source {script}
        [[ $(complete -p marl-mm) == *"-F _marl_mm marl-mm" ]] || exit 3
        COMP_WORDS=({" ".join(f"'{word}'" for word in words)})
        COMP_CWORD={len(words) - 1}
        _marl_mm
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    command = ["bash", "--norc", "-uc", code]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    assert not run.stderr
    return run.stdout.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("marl-mm tra", ["train"]),
        ("marl-mm datasets ver", ["verify"]),
        ("marl-mm train mad", ["maddpg", "maddpg-her"]),
        ("marl-mm train mabc --dev", ["--device"]),
        ("marl-mm train mabc --device ", ["cpu", "cuda"]),
        ("marl-mm train mabc --device cpu --see", ["--seeds"]),
        ("marl-mm collect pd --alpha-rule ro", ["room"]),
        ("marl-mm collect pd --no-res", ["--no-resume"]),
        ("marl-mm eval runs/mabc/0 --epi", ["--episodes"]),
        ("marl-mm bench control --solver ", ["active-set", "proxqp", "daqp"]),
        ("marl-mm eval runs/ma", []),  # files are bash's own business
        ("marl-mm --print-completion ", ["bash"]),
    ],
)
def test_words_are_completed(script: Path, line: str, expected: list[str]) -> None:
    assert sorted(completed(script, line)) == sorted(expected)


def test_all_commands_are_offered_and_all_have_options(script: Path) -> None:
    offered = completed(script, "marl-mm ")
    assert {*COMMANDS, *LISTS, "--help", COMPLETION} <= set(offered)
    for command in (*COMMANDS, *LISTS):
        assert "--help" in completed(script, f"marl-mm {command} --"), command


@pytest.mark.usefixtures("registries")
def test_what_a_plugin_adds_is_completed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugin = Path(__file__).resolve().parents[2] / "examples/plugins/awac.py"
    assert main(["--plugin", str(plugin), COMPLETION, "bash"]) == 0
    path = tmp_path / "with-plugin"
    path.write_text(capsys.readouterr().out)
    assert completed(path, "marl-mm train awac --temper") == ["--temperature"]


def test_the_choices_of_an_option_are_in_one_order(script: Path) -> None:
    """tyro has them in sets, whose order is another in each process."""
    assert '="None bullet mujoco"' in script.read_text()


def test_other_shells_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([COMPLETION, "fish"]) == 2
    assert "--print-completion is 'fish', expected bash" in capsys.readouterr().err
