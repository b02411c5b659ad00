"""Hyper-parameters that the tuning chose, by algorithm, as its table says."""

from collections.abc import Mapping
from typing import Any

CHOSEN: Mapping[str, Mapping[str, Any]] = {}
"""Values that replace the presets', by registered name; none where none is tuned."""
