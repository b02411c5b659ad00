"""The controller's tick in one compiled call: assembly, levels, QP, torques.

The same mathematics as in ``marl_mm.control.reference``, which explains it and which
the tests compare it with; here in loops over preallocated rows, because at 240 Hz and
nine variables the cost of Python and numpy calls exceeds the arithmetic twenty times.
"""
