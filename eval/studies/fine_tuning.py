"""Offline to online: four ways to go on from data with own episodes."""

from itertools import product
from typing import Any

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.eval.studies.shown import Curves
from marl_mm.eval.studies.study import Setting, Study
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.sources import Source

OWN = FineTuning(online_steps=5_000)
"""Own episodes of all ways but RLPD, which makes more updates."""

_SHARED: dict[str, Any] = {"curve_every": 5_000, "curve_goals": 50}

WAYS = (
    Setting(
        "td3-bc-kept",
        "TD3+BC",
        changes={"updates": 5_000},
        fine_tuning=OWN,
        **_SHARED,
    ),
    Setting(
        "matd3-bc-kept",
        "MATD3+BC",
        "matd3-bc",
        changes={"updates": 5_000},
        fine_tuning=OWN,
        **_SHARED,
    ),
    Setting(
        "cal-ql-kept",
        "Cal-QL",
        "cal-ql",
        changes={"updates": 5_000},
        fine_tuning=OWN,
        **_SHARED,
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
"""Ways that are compared."""

SOURCES = (
    Source("scripted", "Grasp-v0", 2_000, name="script-2k-Grasp", engine="mujoco"),
    RECIPES.get("quiet-zone-explore").source,
    RECIPES.get("gate-expert").source,
)
"""Datasets that are begun with."""

FINE_TUNING = Study(
    "Table: going on online from data of three tasks.",
    tuple(product(SOURCES, WAYS)),
    figure=Curves(panels="dataset"),
    seeds=5,
)
"""Study of the ways."""
