"""Online learning: the paper's Figs. 4 and 5, demonstrations, and what helps."""

from collections.abc import Mapping, Sequence
from typing import Any

from marl_mm.eval.bench import SB3
from marl_mm.eval.studies.study import (
    BEST,
    LAST,
    Cell,
    Curves,
    Online,
    Reported,
    Setting,
    Source,
    Study,
    cell_name,
)

_REACH, _SMOOTH, _GRASP = map(Online, ("Reach-v0", "SmoothReach-v0", "Grasp-v0"))

_PD = Source(settings={"alpha_rule": "room"}, steps=2_000, name="demonstrations")
_REACH_SHOWN = Online("Reach-v0", _PD)
_GRASP_SHOWN = Online(
    "Grasp-v0", Source("scripted", "Grasp-v0", 2_000, name="demonstrations-Grasp")
)


def _her(name: str, about: str, **changes: Any) -> Setting:
    return Setting(name, f"DDPG + HER{about}", "ddpg-her", changes=changes)


def _departure(name: str, about: str, **changes: Any) -> Setting:
    """The tuned preset with one hyper-parameter back at Table 2's or the plain one."""
    return _her(f"ddpg-her-{name}", f", {about}", **{"episodes": 300, **changes})


_MADDPG, _SHOWN = "maddpg-her", ", demonstrations"

_OF_GRASP = 1_000
"""Episodes of runs on Grasp-v0, whatever the preset has."""

CELLS: Mapping[str, Cell] = {
    setting.name: (source, setting)
    for source, setting in (
        (_REACH, Setting("ddpg", "DDPG", "ddpg")),
        (_REACH, _her("ddpg-her", "")),
        (_REACH, Setting(_MADDPG, "MADDPG + HER", _MADDPG)),
        (_REACH, Setting("ddpg-paper", "DDPG, Table 2", "ddpg", "paper")),
        (
            _REACH,
            Setting("ddpg-her-paper", "DDPG + HER, Table 2", "ddpg-her", "paper"),
        ),
        (
            _REACH,
            Setting(SB3, "Stable-Baselines3, DDPG + HER", "ddpg-her", library="sb3"),
        ),
        (_REACH_SHOWN, Setting("ddpg-demonstrations", f"DDPG{_SHOWN}", "ddpg")),
        (_REACH_SHOWN, _her("ddpg-her-demonstrations", _SHOWN)),
        (_SMOOTH, _her("ddpg-her-smooth", "")),
        (_SMOOTH, Setting("maddpg-her-smooth", "MADDPG + HER", _MADDPG)),
        (_GRASP, _her("ddpg-her-grasp", "", episodes=_OF_GRASP)),
        (
            _GRASP_SHOWN,
            _her("ddpg-her-grasp-demonstrations", _SHOWN, episodes=_OF_GRASP),
        ),
        (
            _REACH,
            Setting(
                "maddpg-her-others",
                "MADDPG + HER, others' replayed actions",
                _MADDPG,
                changes={"others": "replay", "episodes": 300},
            ),
        ),
        (_REACH, _departure("no-layer-norm", "no layer norm", layer_norm=False)),
        (_REACH, _departure("no-clip", "targets not cut off", clip_targets=False)),
        (_REACH, _departure("no-penalty", "no action penalty", action_penalty=0.0)),
        (
            _REACH,
            _departure("warm-up", "warm-up 5,000", warm_up=5_000, episodes=400),
        ),
        (_REACH, _departure("capacity", "replay of 5,000", capacity=5_000)),
        (
            _REACH,
            _departure("updates", "25 updates an episode", updates_per_episode=25),
        ),
        (
            _REACH,
            _departure("cycle", "1 episode a cycle", episodes_per_cycle=1),
        ),
    )
}
"""Cells by the name of their setting."""

_PLAIN = Reported("Sec. 5.4.1", words="under 40")
_HINDSIGHT = Reported("Sec. 5.4.1", words="70 by about episode 90")
_PAPER = {
    "ddpg": _PLAIN,
    "ddpg-paper": _PLAIN,
    "ddpg-her": _HINDSIGHT,
    "ddpg-her-paper": _HINDSIGHT,
}

LOWEST_RETURN = -30.0
"""Lower end of Fig. 4: few agents that have learnt nothing drive off, to -200."""


def _study(about: str, names: Sequence[str], figure: bool | Curves = False) -> Study:
    cells = [CELLS[name] for name in names]
    theirs = {cell_name(CELLS[n]): _PAPER[n] for n in names if n in _PAPER}
    return Study(about, cells, (LAST, BEST), figure, theirs, table="episodes")


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
