"""What a message says of a config that is not the one of the beginning."""

from pathlib import Path
from typing import Any

import pytest

from marl_mm.config_diff import as_json, refuse_other_config
from marl_mm.errors import OtherConfigError

RUN = Path("runs/mabc/0")
THEIRS: dict[str, Any] = {"seed": 0, "config": {"lr": 0.1, "hidden": [8]}, "old": 1}


def test_equal_configs_pass_whatever_json_does_to_them() -> None:
    refuse_other_config(RUN, THEIRS, {"seed": 0, "config": {"hidden": (8,)}})
    assert as_json({"hidden": (8, 8)}) == {"hidden": [8, 8]}


def test_each_value_that_differs_is_named_with_both_sides() -> None:
    mine = {"seed": 1, "config": {"lr": 0.2, "hidden": (8,)}, "new": {"a": 1, "b": 2}}
    with pytest.raises(OtherConfigError) as refused:
        refuse_other_config(RUN, THEIRS, mine)
    assert refused.value.difference == (
        "runs/mabc/0 was made with seed = 0 (now 1), config.lr = 0.1 (now 0.2), "
        "new = None (now {2 values})"
    )
    assert "`overwrite=True`" in str(refused.value)


def test_of_many_values_six_are_named() -> None:
    theirs, mine = (dict.fromkeys("abcdefgh", value) for value in (0, 1))
    with pytest.raises(OtherConfigError, match=r"f = 0 \(now 1\), 2 more: go on"):
        refuse_other_config(RUN, theirs, mine)
