"""The robot: its description, its limits and its rigid-body model."""
