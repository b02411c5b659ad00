"""Studies: settings that learn from sources, compared in tables and figures."""

from marl_mm.eval.studies.settings import BEST, LAST, Online, Probe, Setting
from marl_mm.eval.studies.shown import Curves, Reported
from marl_mm.eval.studies.study import Study
from marl_mm.runs.sources import Mix, Source

__all__ = [
    "BEST",
    "LAST",
    "Curves",
    "Mix",
    "Online",
    "Probe",
    "Reported",
    "Setting",
    "Source",
    "Study",
]
