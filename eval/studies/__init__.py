"""Studies: settings that learn from sources, compared in tables and figures."""

from marl_mm.eval.studies.study import (
    BEST,
    LAST,
    Curves,
    Mix,
    Online,
    Probe,
    Reported,
    Setting,
    Source,
    Study,
)

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
