"""Scripted policies and the loop that turns policies into datasets."""
