"""Words of a command line that are slips or tricks are usage errors of one line."""

from pathlib import Path

import pytest

import marl_mm
from marl_mm.algorithms.config_checks import LARGEST, LARGEST_BATCH
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.flow_bc_config import FlowBcConfig
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.cli import main
from marl_mm.datasets.location import locate
from marl_mm.errors import UsageError
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.words import check_words

MABC = "train", "mabc", "--dataset", "good-5k"

Output = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*MABC, "--batch-size", "99999999999"), "at most 100,000"),
        ((*MABC, "--updates", "99999999999"), "at most 1,000,000,000"),
        ((*MABC, "--hidden", "1000000", "1000000"), "at most 100,000,000 weights"),
        ((*MABC, "--seeds", "99999999999999999999"), "expected below"),
        ((*MABC, "--eval-episodes", "99999999999"), "--eval-episodes is 99999999999"),
        ((*MABC, "--out", ""), "the value after --out is empty"),
        ((*MABC, "--out="), "the value after --out is empty"),
        (("eval", "pd", "--episodes", "9" * 20), "--episodes is 99999999999999999999"),
        (("eval", "pd", "--task", ""), "the value after --task is empty"),
        (("collect", "pd", "--steps", "٣٠"), "other digits than 0 to 9"),
        (("collect", "pd", "--steps=३०"), "other digits than 0 to 9"),
        (("datasets", "mix", "good-5k:٣٠", "--out", "x"), "other digits than 0 to 9"),
        (("collect", "pd", "--steps", "9" * 20), "--steps is 99999999999999999999"),
        (("collect", "pd", "--dataset", "a\nb"), r"control character in it: 'a\nb'"),
        (("play", "pd", "--video", "a\x1b[1m.mp4"), "control character"),
        (("runs", "a\u2028b"), "control character"),
        (("",), "the value after the command is empty"),
    ],
)
def test_slips_and_tricks_are_usage_errors(
    datasets_home: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Output,
    words: tuple[str, ...],
    message: str,
) -> None:
    """Before anything is done."""
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not [*tmp_path.glob("**/0")]


def test_what_names_may_have_in_them_is_not_refused() -> None:
    check_words(
        ["--out", "/مجلد/١٤٠٣", "--name", "½ été 2²", "--x=1", "a=", "--", "-1"]
    )


def test_python_is_told_the_same(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`out` is ''"):
        marl_mm.train("mabc", "good-5k", out="")
    with pytest.raises(UsageError, match="task ''"):
        marl_mm.evaluate("pd", task="")
    with pytest.raises(UsageError, match=r"name has a control character .* 'a\\nb'"):
        locate("a\nb")


@pytest.mark.parametrize("config", [MabcConfig, Td3BcConfig, DdpgConfig])
def test_sizes_have_bounds(config: type[MabcConfig]) -> None:
    config(batch_size=LARGEST_BATCH, hidden=(10_000, 9_000))
    with pytest.raises(UsageError, match="batch_size is 100001, expected at most"):
        config(batch_size=LARGEST_BATCH + 1)
    with pytest.raises(UsageError, match=r"hidden is \(10001, 10000\)"):
        config(hidden=(10_001, 10_000))
    with pytest.raises(UsageError, match=r"hidden is \(1000000000,\)"):
        config(hidden=(LARGEST,))


def test_a_flow_has_no_more_steps_than_its_file_may_have() -> None:
    FlowBcConfig(flow_steps=1_000)
    with pytest.raises(UsageError, match="flow_steps is 1001, expected at most 1,000"):
        FlowBcConfig(flow_steps=1_001)


def test_counts_and_seeds_have_bounds() -> None:
    check_positive(steps=LARGEST, episodes=25_000)
    check_seed(2**32)
    with pytest.raises(UsageError, match="`steps` is 1000000001, expected at most"):
        check_positive(steps=LARGEST + 1)
    with pytest.raises(UsageError, match="`episodes` is 25001, expected at most"):
        check_positive(episodes=25_001)
    with pytest.raises(UsageError, match="the seed is"):
        check_seed(2**63)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MemoryError(), 1),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), 1),
    ],
)
def test_too_little_memory_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: Output, error: Exception, code: int
) -> None:
    def fail(words: list[str]) -> int:
        raise error

    monkeypatch.setattr("marl_mm.cli._run", fail)
    assert main(["tasks"]) == code
    assert "not enough memory" in capsys.readouterr().err
    monkeypatch.setattr("marl_mm.cli._is_memory", lambda error: False)
    with pytest.raises(type(error)):
        main(["tasks"])
