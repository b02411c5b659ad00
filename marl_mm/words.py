"""Words that somebody typed: what they may not hold, wherever they stand."""

import re
import unicodedata
from collections.abc import Sequence

from marl_mm.errors import UsageError


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

    So is what no file of ours may hold, see ``received.is_printable``: characters that
    cannot be seen, and bytes that are no UTF-8.

    Args:
        what: Name of the text, for messages.
        text: The text.

    Raises:
        UsageError: If it has one.
    """
    kinds = {unicodedata.category(c) for c in text}
    if kinds & {"Zl", "Zp"} or any(kind.startswith("C") for kind in kinds):
        raise UsageError(f"{what} has a control character in it: {text[:60]!a}")


def _is_number(text: str) -> bool:
    try:
        float(text)
        return True
    except ValueError:
        return False
