"""Returns to measure others by, per task: random as 0, the best agent at hand as 1.

That is the pretrained agent on the task it learnt, and the PD agent on others.

Measured, and kept in ``reference_scores.json`` with the command that made them. Minari
normalises scores with them.
"""

import json
from importlib import resources
from typing import Any

FILE = "reference_scores.json"


def reference_scores(task: str | None) -> dict[str, Any]:
    """Minari's metadata of a task's reference scores; nothing for unknown tasks."""
    text = resources.files("marl_mm.datasets").joinpath(FILE).read_text()
    scores = json.loads(text)["tasks"].get(task)
    if scores is None:
        return {}
    return {
        "ref_min_score": scores["random"],
        "ref_max_score": max(scores["pd"], scores["pretrained"]),
        "num_episodes_average_score": scores["episodes"],
    }
