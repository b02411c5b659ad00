"""Warm-up of the fork server: imported last, so that forked workers share memory.

It restores the environment variables that the server's start has changed. Where the
environments were imported it takes one step, which loads the compiled code for all
workers. It then freezes the garbage collector: a worker's first collection would
otherwise write to every page and copy it.
"""

import ctypes
import gc
import json
import logging
import os
import sys

from marl_mm.processes import SAVED, set_variables


def _load_compiled_code() -> None:
    import numpy as np

    from marl_mm.envs.core import EpisodeCore
    from marl_mm.envs.registry import make_task

    logging.disable()  # which engine it is says the parent
    core = EpisodeCore(make_task())
    logging.disable(logging.NOTSET)
    core.reset(np.random.default_rng(0))
    core.step(np.zeros(4))
    core.close()


def _return_free_memory() -> None:
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
    if trim is not None:
        trim(0)


if SAVED in os.environ:
    set_variables(json.loads(os.environ[SAVED]))
if "marl_mm.envs.core" in sys.modules:
    _load_compiled_code()
gc.collect()
_return_free_memory()
gc.freeze()
