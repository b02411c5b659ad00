"""Evaluation: fixed goals, rows per episode, success with its interval."""

from marl_mm.eval.evaluate import evaluate

__all__ = ["evaluate"]
