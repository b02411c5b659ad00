"""Online learning: the paper's Figs. 4 and 5, demonstrations, and what helps."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

from marl_mm.algorithms.registry import TUNED
from marl_mm.eval.bench import SB3
from marl_mm.eval.studies.settings import BEST, LAST, Online, Setting
from marl_mm.eval.studies.shown import Curves, Reported
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.runs.sources import Source

_REACH = Online("Reach-v0")

_PD = Source(settings={"alpha_rule": "room"}, steps=2_000, name="demonstrations")
_SCRIPT = Source("scripted", "Grasp-v0", 2_000, name="demonstrations-Grasp")


def _setting(
    algorithm: str, name: str, about: str, preset: str = TUNED, **changes: Any
) -> Setting:
    about = f"{algorithm.upper().replace('-', ' + ')}{about}"
    return Setting(f"{algorithm}{name}", about, algorithm, preset, changes)


_ddpg = partial(_setting, "ddpg")
_her = partial(_setting, "ddpg-her")
_maddpg = partial(_setting, "maddpg-her")


def _departure(name: str, about: str, **changes: Any) -> Setting:
    """The tuned preset with one hyper-parameter back at Table 2's or the plain one."""
    return _her(f"-{name}", f", {about}", **{"episodes": 300, **changes})


_OF_GRASP = 1_000
"""Episodes of runs on Grasp-v0, whatever the preset has."""

_SB3 = Setting(SB3, "Stable-Baselines3, DDPG + HER", "ddpg-her", library="sb3")

_SHOWN = Online("Reach-v0", _PD)
_GRASP, _SHOWN_GRASP = Online("Grasp-v0"), Online("Grasp-v0", _SCRIPT)
_SMOOTH = Online("SmoothReach-v0")

_LEARNT: Sequence[tuple[Online, Setting]] = (
    (_REACH, _ddpg("", "")),
    (_REACH, _her("", "")),
    (_REACH, _maddpg("", "")),
    (_REACH, _ddpg("-paper", ", Table 2", "paper")),
    (_REACH, _her("-paper", ", Table 2", "paper")),
    (_REACH, _SB3),
    (_SHOWN, _ddpg("-demonstrations", ", demonstrations")),
    (_SHOWN, _her("-demonstrations", ", demonstrations")),
    (_SMOOTH, _her("-smooth", "")),
    (_SMOOTH, _maddpg("-smooth", "")),
    (_GRASP, _her("-grasp", "", episodes=_OF_GRASP)),
    (
        _SHOWN_GRASP,
        _her("-grasp-demonstrations", ", demonstrations", episodes=_OF_GRASP),
    ),
    (
        _REACH,
        _maddpg("-others", ", others' replayed actions", others="replay", episodes=300),
    ),
    *product(
        (_REACH,),
        (
            _departure("no-layer-norm", "no layer norm", layer_norm=False),
            _departure("no-clip", "targets not cut off", clip_targets=False),
            _departure("no-penalty", "no action penalty", action_penalty=0.0),
            _departure("warm-up", "warm-up 5,000", warm_up=5_000, episodes=400),
            _departure("capacity", "replay of 5,000", capacity=5_000),
            _departure("updates", "25 updates an episode", updates_per_episode=25),
            _departure("cycle", "1 episode a cycle", episodes_per_cycle=1),
        ),
    ),
)

CELLS: Mapping[str, tuple[Online, Setting]] = {cell[1].name: cell for cell in _LEARNT}
"""Cells by the name of their setting."""

_PLAIN = Reported("Sec. 5.4.1", words="under 40")
_HINDSIGHT = Reported("Sec. 5.4.1", words="70 by about episode 90")
_PAPER = {
    "ddpg": _PLAIN,
    "ddpg-paper": _PLAIN,
    "ddpg-her": _HINDSIGHT,
    "ddpg-her-paper": _HINDSIGHT,
}

_SCRIPT_MUJOCO = replace(_SCRIPT, name=f"{_SCRIPT.name}-mujoco", engine="mujoco")

_IMITATES = _her(
    "-imitation",
    ", imitation",
    imitation_weight=100.0,
    demonstration_share=0.5,
    action_penalty=0.0,  # it pulls the grip to its threshold
    warm_up=50,  # random grips end an episode within two steps
    noise=0.05,  # 0.5 cm: the script closes within 1.2 cm of the block's centre
    actor_learning_rate=5e-4,
)

GRASP = Study(
    "Online learning of a grasp, with imitation of a script's 2,000 steps.",
    [(Online("Grasp-v0", _SCRIPT_MUJOCO), _IMITATES)],
    (LAST, BEST),
    table="episodes",
)
"""Study of a task where exploration finds nothing, on MuJoCo."""

LOWEST_RETURN = -30.0
"""Lower end of Fig. 4: few agents that have learnt nothing drive off, to -200."""


def _study(about: str, names: Sequence[str], figure: bool | Curves = False) -> Study:
    cells = [CELLS[name] for name in names]
    reported = {cell_name(CELLS[n]): _PAPER[n] for n in names if n in _PAPER}
    return Study(about, cells, (LAST, BEST), figure, reported, table="episodes")


_COMPARED = ("ddpg", "ddpg-her", "maddpg-her", "ddpg-paper", "ddpg-her-paper")
_RETURN = f"return of the evaluation, cut off at {LOWEST_RETURN:g}"

STUDIES = {
    "online": _study(
        "Online learning: success, and episodes to 70 and 95 %, per setting.",
        tuple(CELLS),
    ),
    "fig4": _study(
        "Fig. 4: return over episodes, with and without hindsight.",
        _COMPARED,
        Curves("return_all", _RETURN, 1.0, LOWEST_RETURN, None),
    ),
    "fig5": _study(
        "Fig. 5: success over episodes, with and without hindsight.", _COMPARED, True
    ),
    "demonstrations": _study(
        "Success over episodes with a dataset beside.",
        (
            *("ddpg", "ddpg-her", "ddpg-demonstrations", "ddpg-her-demonstrations"),
            *("ddpg-her-grasp", "ddpg-her-grasp-demonstrations"),
        ),
        Curves(panels="task"),
    ),
}
"""Studies by the name of the target of ``marl-mm ablate``."""
