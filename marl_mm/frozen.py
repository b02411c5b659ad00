"""Imported last by a process that others are copies of: what is there stays shared.

Else the first collection of garbage in each copy would write to all of it.
"""

import gc

gc.collect()
gc.freeze()
