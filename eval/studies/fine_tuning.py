"""Offline to online: ways to go on from data with own episodes."""

from itertools import product
from typing import Any

from marl_mm.algorithms.chosen import CHOSEN
from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.eval.studies.settings import Setting, setting_of
from marl_mm.eval.studies.shown import Curves
from marl_mm.eval.studies.study import Study
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.sources import Source

OWN = FineTuning(online_steps=5_000)
"""Own episodes of all ways but RLPD, which makes more updates."""

_SHARED: dict[str, Any] = {"curve_every": 5_000, "curve_goals": 50}

TUNED_AS = {
    **{name: name for name in ("td3-bc", "matd3-bc")},
    **{"cal-ql": "cql", "ma-cal-ql": "cfcql"},
}
"""Algorithms that first learn from the data, and whose tuned settings they have."""

WAYS = (
    *(
        setting_of(
            f"{name}-kept", name, 5_000, CHOSEN[tuned], fine_tuning=OWN, **_SHARED
        )
        for name, tuned in TUNED_AS.items()
        if tuned in CHOSEN
    ),
    Setting(
        "rlpd-kept",
        "RLPD",
        "rlpd",
        changes={"future": 0.2, "elsewhere": 0.4},  # as TD3+BC's preset has it
        fine_tuning=FineTuning(online_steps=5_000, updates_per_step=4),
        **_SHARED,
    ),
)
"""Ways that are compared: those that are tuned, and RLPD."""

SOURCES = (
    Source("scripted", "Grasp-v0", 2_000, name="script-2k-Grasp", engine="mujoco"),
    RECIPES.get("quiet-zone-explore").source,
    RECIPES.get("gate-expert").source,
)
"""Datasets that are begun with."""

FINE_TUNING = Study(
    "Table: going on online from data.",
    tuple(product(SOURCES, WAYS)),
    figure=Curves(panels="dataset"),
    seeds=5,
)
"""Study of the ways."""
