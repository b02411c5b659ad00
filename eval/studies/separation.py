"""Datasets of the team's tasks on which algorithms come apart."""

from itertools import product

from marl_mm.eval.studies.study import Setting, Study
from marl_mm.runs.recipes import RECIPES

UPDATES = 5_000
"""Updates of all algorithms."""

LEARNERS = tuple(
    Setting(f"{name}-5k", about, name, changes={"updates": UPDATES}, curve_goals=20)
    for name, about in (
        ("mabc", "MABC"),
        ("td3-bc", "TD3+BC"),
        ("matd3-bc", "MATD3+BC"),
        ("iql", "IQL"),
    )
)
"""Algorithms that are compared."""

DATASETS = (
    *("quiet-zone-expert", "quiet-zone-narrow", "quiet-zone-noisy"),
    *("quiet-zone-explore", "quiet-zone-rare", "quiet-zone-stitch"),
    *("gate-expert", "gate-stitch", "moving-reach-explore"),
    *("bar-noisy", "bar-conventions"),
)
"""Names of their recipes."""

SEPARATION = Study(
    "Table: MABC, TD3+BC, MATD3+BC and IQL on datasets of tasks in which the team "
    "decides.",
    tuple(product((RECIPES.get(name).source for name in DATASETS), LEARNERS)),
    seeds=5,
)
"""Study of the datasets."""
