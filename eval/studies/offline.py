"""Our tables of offline learning: other datasets and tasks, and why learning fails."""

from functools import partial
from itertools import product
from typing import Any

from marl_mm.algorithms.registry import TUNED
from marl_mm.eval.studies.paper import GOOD, beside_the_paper, label
from marl_mm.eval.studies.settings import LAST, Probe, Setting
from marl_mm.runs.paper import GOOD_30K, MIXES, PD_30K
from marl_mm.runs.sources import Source

OTHER_TASKS = (
    Source("pretrained", "SmoothReach-v0", 30_000, name="smooth-30k"),
    Source("pretrained", "PreciseReach-v0", 30_000, name="precise-30k"),
)

BLOCKS = tuple(
    Source("scripted", task, 20_000, name=f"marl_mm/{folder}/scripted-v0")
    for task, folder in (
        ("CarryReach-v0", "carry-reach"),
        ("Grasp-v0", "grasp"),
        ("GraspReach-v0", "grasp-reach"),
    )
)
"""Datasets of tasks with a block."""

_MABC = Setting("mabc", "MABC", "mabc")
_TD3_BC = Setting("td3-bc", "TD3+BC")
_MATD3_BC = Setting("matd3-bc", "MATD3+BC", "matd3-bc")
LEARNERS = (_MABC, _TD3_BC, _MATD3_BC)

_FEWER = 100
"""Evaluation goals per run in ``cures``, where settings are only compared with each
other."""

_UPDATES = {"updates": _TD3_BC.config.updates}
"""Updates of the tuned preset, used for the literal ones too; Table 3 has 100,000."""


def _changed(algorithm: str, name: str, about: str, **changes: Any) -> Setting:
    """The tuned preset with one change."""
    about = f"{label(algorithm)}, {about}"
    return Setting(f"{algorithm}-{name}", about, algorithm, TUNED, changes, _FEWER)


_cure, _multi = partial(_changed, "td3-bc"), partial(_changed, "matd3-bc")


def _literal(algorithm: str, name: str, about: str, **changes: Any) -> Setting:
    """The paper's preset with as many updates as the tuned one."""
    about = f"{label(algorithm)} as in the paper, {about}"
    changes = _UPDATES | changes
    name = f"{algorithm}-literal{name}"
    return Setting(name, about, algorithm, "paper", changes, _FEWER)


_ONE_CURE = (
    _literal("td3-bc", "-clip", "but targets cut off", clip_targets=True),
    _literal("td3-bc", "-layer-norm", "but layer norm", layer_norm=True),
    _literal("td3-bc", "-goals", "but other goals too", future=0.2, elsewhere=0.4),
    _literal("td3-bc", "-scaled", "but imitation scaled", imitation_scaled=True),
)
"""The paper's preset, which fails, with exactly one of our changes."""

_UNSCALED = _cure("unscaled", "imitation not scaled by spread", imitation_scaled=False)

_CURES = (
    _literal("td3-bc", "", "c = 2.5"),
    _literal("td3-bc", "-c0.5", "but c = 0.5", q_weight=0.5),
    *_ONE_CURE,
    _TD3_BC,
    _cure("c2.5", "c = 2.5", q_weight=2.5),
    _cure("no-clip", "targets not cut off", clip_targets=False),
    _cure("no-layer-norm", "no layer norm", layer_norm=False),
    _cure("own-goals", "own goals only", future=0.0, elsewhere=0.0),
    _UNSCALED,
    _literal("matd3-bc", "", "c = 2.5"),
    _MATD3_BC,
)

_FINER_CURES = (
    _literal("td3-bc", "-successful", "but successes only", imitate="successful"),
    _cure("c1", "c = 1", q_weight=1.0),
    _cure("c0.1", "c = 0.1", q_weight=0.1),
    _cure("c-falls", "c from 2.5 to 0.1", q_weight=2.5, q_weight_end=0.1),
    _cure("no-elsewhere", "no other episodes' goals", elsewhere=0.0),
    _cure("no-future", "no goals of later steps", future=0.0),
    _cure("better", "better actions imitated", imitate="better"),
    _cure("all", "all episodes imitated", imitate="all"),
    _cure("a-x", "delta_x imitated fourfold", imitation_weights=(4.0, 1.0, 1.0, 1.0)),
    _multi("own", "a critic for each agent", critics="own"),
    _multi("data", "others' actions from the data", others="data"),
)
"""Further changes, for a mix only: on good data, where every episode succeeds, some
make no difference."""

_HELD = tuple(
    Probe(f"alpha-{alpha:g}", f"alpha {alpha:g}", alpha=alpha)
    for alpha in (0.0, 0.25, 0.5, 0.75, 1.0)
)

_WITHIN = tuple(
    Probe(
        f"within-{distance:g}",
        f"within {100 * distance:g} cm",
        overrides={"success_distance": distance},
    )
    for distance in (0.01, 0.02, 0.10)
)
"""Evaluations with other success distances than the 5 cm of ``Reach-v0``."""

STUDIES = {
    "offline": beside_the_paper(
        "Table: MABC, TD3+BC and MATD3+BC on the paper's datasets.",
        tuple(product((*GOOD, PD_30K, *MIXES), LEARNERS)),
    ),
    "tasks": beside_the_paper(
        "Table: the same on SmoothReach-v0 and PreciseReach-v0.",
        tuple(product(OTHER_TASKS, LEARNERS)),
    ),
    "blocks": beside_the_paper(
        "Table: the same on 20,000 steps of a script that carries, takes, or both.",
        tuple(product(BLOCKS, LEARNERS)),
    ),
    "cures": beside_the_paper(
        "Table: why TD3+BC and MATD3+BC fail, and what cures them.",
        (
            *product((MIXES[1],), (*_CURES, *_FINER_CURES)),
            *product((GOOD_30K,), _CURES),
            *product((PD_30K,), (_TD3_BC, _UNSCALED)),
        ),
    ),
    "held": beside_the_paper(
        "Table: what the learnt alpha is worth against one held.",
        tuple(product((GOOD_30K, *OTHER_TASKS), LEARNERS)),
        (LAST, *_HELD),
    ),
    "within": beside_the_paper(
        "Table: how much hangs on the distance that counts as reached.",
        tuple(product((GOOD_30K, MIXES[1]), LEARNERS)),
        (LAST, *_WITHIN),
    ),
}
"""Studies by the name of the target of ``marl-mm ablate``."""
