"""What the package promises of its own tasks, algorithms and collectors, to be checked.

The tests hold it for what is built in, ``marl-mm check`` for what plug-ins add.
"""
