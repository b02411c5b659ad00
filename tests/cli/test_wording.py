"""Messages in the words of the command line."""

from pathlib import Path

import pytest

from marl_mm.cli import main
from marl_mm.commands.wording import as_options
from marl_mm.errors import OutputExistsError
from marl_mm.files import refuse_existing


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("add `overwrite=True`", "add --overwrite"),
        ("or `resume=False`: no", "or --no-resume: no"),
        ("use `max_steps` and `task`", "use --max-steps and --task"),
        ("needs `marl_mm.plugins.load(...)`", "needs --plugin"),
        ("`marl_mm.collect(...)` stays", "`marl_mm.collect(...)` stays"),
        ("`Reach-v0` and 'task' stay", "`Reach-v0` and 'task' stay"),
    ],
)
def test_parameters_in_backquotes_are_options(text: str, words: str) -> None:
    assert as_options(text) == words


@pytest.mark.slow
def test_python_names_the_parameter_and_the_command_line_the_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken.h5"
    taken.touch()
    with pytest.raises(OutputExistsError, match=r"add `overwrite=True`$"):
        refuse_existing(taken, overwrite=False)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    assert main(["datasets", "export", "good-5k", "--out", str(taken)]) == 2
    assert capsys.readouterr().err.endswith("add --overwrite\n")
