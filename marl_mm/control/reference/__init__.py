"""The controller once more, to be read: numpy, with ProxQP or DAQP for its QPs.

``marl_mm.control.compiled`` is what runs. The tests hold it to this one.
"""
