"""Reference pages, made of the registries and the committed results."""

from collections.abc import Callable

PAGES: dict[str, Callable[[], str]] = {}
"""Path below docs/, and what makes the page."""
