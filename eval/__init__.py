"""Evaluation: fixed goals, rows per episode, success with its interval."""
