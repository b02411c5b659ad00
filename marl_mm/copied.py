"""Imported last by a process that others are copies of: ready to be copied.

Its environment becomes what it would have been. What is there stays shared: else the
first collection of garbage in each copy would write to all of it.
"""

import gc
import json
import os

from marl_mm.processes import BEFORE, set_environment

if BEFORE in os.environ:
    set_environment(json.loads(os.environ[BEFORE]))
gc.collect()
gc.freeze()
