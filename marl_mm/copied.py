"""Imported last by a process that others are copies of: ready to be copied.

Its environment becomes what it would have been, and where there are environments it
takes a step, so that each copy need not load compiled code. What is there then stays
shared: else a copy's first collection of garbage would write to all of it.
"""

import ctypes
import gc
import json
import os
import sys

from marl_mm.processes import BEFORE, set_variables


def _take_a_step() -> None:
    import numpy as np

    from marl_mm.envs.core import EpisodeCore
    from marl_mm.envs.registry import make_task

    core = EpisodeCore(make_task())
    core.reset(np.random.default_rng(0))
    core.step(np.zeros(4))
    core.close()


def _give_back_what_is_free() -> None:
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
    if trim is not None:
        trim(0)


if BEFORE in os.environ:
    set_variables(json.loads(os.environ[BEFORE]))
if "marl_mm.envs.core" in sys.modules:
    _take_a_step()
gc.collect()
_give_back_what_is_free()
gc.freeze()
