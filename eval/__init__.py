"""Evaluation: fixed goals, rows per episode, success with its interval; ablations."""

from marl_mm.eval.ablations import BEST, LAST, Ablation, Probe, Setting
from marl_mm.eval.evaluate import evaluate

__all__ = ["BEST", "LAST", "Ablation", "Probe", "Setting", "evaluate"]
