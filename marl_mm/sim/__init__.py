"""The simulator: the only package that imports an engine."""
