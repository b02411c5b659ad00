"""Words that somebody typed: what they may not hold, wherever they stand."""

import re
import unicodedata
from collections.abc import Sequence

from marl_mm.errors import UsageError

_JOINERS = "\u200c\u200d\u200e\u200f"
"""Joiners of letters and emoji, and marks of direction, which names have."""


def check_words(words: Sequence[str]) -> None:
    """Raise for the first word of a command line that is a slip or a trick.

    Raises:
        UsageError: If it is empty, has a control character in it, or a number in other
            digits than 0 to 9.
    """
    for before, word in zip(("the command", *words), words, strict=False):
        option, equals, value = word.partition("=")
        if not word or (equals and not value and option.startswith("--")):
            raise UsageError(f"the value after {option or before} is empty")
        refuse_control_characters("an argument", word)
        for part in re.split("[:=,]", word):
            if not part.isascii() and _is_number(part):
                raise UsageError(f"{word} has other digits than 0 to 9")


def refuse_control_characters(what: str, text: str) -> None:
    """Raise for a text with a line break, an escape or another control character.

    Hidden characters and bytes that are no UTF-8 count: files of ours hold none.

    Args:
        what: Name of the text, for messages.
        text: The text.

    Raises:
        UsageError: If it has one.
    """
    for place, character in enumerate(text):
        if not is_harmless(character):
            part = text[max(0, place - 30) : place + 30]
            raise UsageError(f"{what} has a control character in it: {part!a}")


def is_harmless(character: str) -> bool:
    """Whether a character does not move, hide or reverse what a terminal shows."""
    kind = unicodedata.category(character)
    return character in _JOINERS or kind not in ("Cc", "Cf", "Cs", "Zl", "Zp")


def _is_number(text: str) -> bool:
    try:
        float(text)
        return True
    except ValueError:
        return False
