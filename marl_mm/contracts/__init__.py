"""Claims that the package makes about its tasks, algorithms, collectors and metrics.

The tests check them for everything built in, ``marl-mm check`` for plug-ins.
"""
