"""Every offline algorithm with its preset, on two datasets that ship."""

from itertools import product

from marl_mm.algorithms.registry import ALGORITHMS, TUNED
from marl_mm.eval.studies.study import LAST, Setting, Study
from marl_mm.runs.recipes import RECIPES

UPDATES = 5_000
"""Updates of all algorithms."""

DATASETS = ("quiet-zone-noisy", "gate-expert")
"""Names of their recipes."""

LEARNERS = tuple(
    Setting(
        f"{name}-baseline",
        found.title,
        name,
        changes={"updates": UPDATES},
        goals=50,
        curve_every=1_000,
        curve_goals=20,
    )
    for name, found in ALGORITHMS.items()
    if not found.online and found.presets[TUNED].updates
)
"""Algorithms that learn from a dataset alone."""

BASELINES = Study(
    "Table: every offline algorithm with its preset, on two datasets that ship.",
    tuple(product((RECIPES.get(name).source for name in DATASETS), LEARNERS)),
    (LAST,),
    seeds=2,
)
"""Study of the algorithms."""
