"""Collectors: policies, and the loop that turns their episodes into datasets."""
