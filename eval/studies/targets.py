"""What ``marl-mm ablate`` makes by name."""

from marl_mm.eval.studies import online, ours, paper

STUDIES = paper.STUDIES | ours.STUDIES | online.STUDIES
"""Studies by name."""

GROUPS = {
    "paper": ("table4", "table5", "fig4", "fig5", "fig7", "fig8", "fig9", "fig10"),
    "all": (*STUDIES, "alpha"),
}
"""Names that stand for several; ``alpha`` is what the learnt alpha is worth."""
