"""Datasets of the team's tasks on which algorithms come apart."""

from itertools import product

from marl_mm.eval.studies.settings import setting_of
from marl_mm.eval.studies.study import Study
from marl_mm.runs.recipes import RECIPES

UPDATES = 5_000
"""Updates of all algorithms."""

LEARNERS = tuple(
    setting_of(f"{name}-5k", name, UPDATES)
    for name in ("mabc", "td3-bc", "matd3-bc", "iql")
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
