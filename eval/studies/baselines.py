"""Every offline algorithm with its preset, on two datasets that ship."""

from itertools import product

from marl_mm.eval.studies.settings import LAST, setting_of
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.tuning_ranges import RANGES
from marl_mm.runs.recipes import RECIPES

UPDATES = 5_000
"""Updates of all algorithms."""

DATASETS = ("quiet-zone-noisy", "gate-expert")
"""Names of their recipes."""

LEARNERS = tuple(
    setting_of(f"{name}-baseline", name, UPDATES, goals=50, curve_every=1_000)
    for name in (*RANGES, "cal-ql", "ma-cal-ql")
)
"""Algorithms that learn from a dataset alone."""

BASELINES = Study(
    "Table: every offline algorithm with its preset, on two datasets that ship.",
    tuple(product((RECIPES.get(name).source for name in DATASETS), LEARNERS)),
    (LAST,),
    seeds=1,
)
"""Study of the algorithms."""
