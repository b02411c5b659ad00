"""Reference returns of each task, with which Minari normalises scores.

Random actions score 0. The better of the pretrained agent, on the task that it learnt,
and the PD agent scores 1. ``reference_scores.json`` holds the measured returns and the
command that measured them.
"""

import json
from importlib import resources
from typing import Any

FILE = "reference_scores.json"


def reference_scores(task: str | None) -> dict[str, Any]:
    """Minari's metadata of a task's reference scores; empty for unknown tasks."""
    text = resources.files("marl_mm.datasets").joinpath(FILE).read_text("utf-8")
    scores = json.loads(text)["tasks"].get(task)
    if scores is None:
        return {}
    return {
        "ref_min_score": scores["random"],
        "ref_max_score": max(scores["pd"], scores["pretrained"]),
        "num_episodes_average_score": scores["episodes"],
    }
