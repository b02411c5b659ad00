"""Datasets of the team's tasks on which algorithms come apart."""

from itertools import product

from marl_mm.eval.studies.offline import LEARNERS
from marl_mm.eval.studies.study import Study
from marl_mm.runs.recipes import RECIPES

DATASETS = (
    *("quiet-zone-expert", "quiet-zone-noisy", "gate-expert", "gate-noisy"),
    *("tray-expert", "tray-noisy", "moving-reach-expert", "bar-conventions"),
)
"""Names of their recipes."""

SEPARATION = Study(
    "Table: MABC, TD3+BC and MATD3+BC on datasets of tasks in which the team decides.",
    tuple(product((RECIPES.get(name).source for name in DATASETS), LEARNERS)),
    seeds=5,
)
"""Study of the datasets."""
