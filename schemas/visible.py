"""Escaping of foreign text, so that it can be printed and stored safely.

Names of vehicles, topics and files, reasons of records and answers of stores may contain anything.
A terminal obeys some of it: it clears the screen, sets the clipboard, or reverses the order of
text.
"""

import re
import unicodedata
from typing import Final

NEWLINES: Final = "\n"
"""Line breaks, to keep where a text has lines of its own, such as a traceback."""

_CONTROLS: Final = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters, line separators, bidirectional overrides, and bytes that are not UTF-8, which
Python represents as surrogates.
"""

_MARK: Final = "…"

_BYTES: Final = range(0xDC80, 0xDD00)
"""Surrogates by which Python represents the bytes of a file name that are not UTF-8."""


def has_controls(text: str) -> bool:
    """Return true if a text contains control characters or bytes that are not UTF-8."""
    return _CONTROLS.search(text) is not None


def visible(text: str, *, keep: str = "", limit: int | None = None) -> str:
    r"""Return the text with each character that does not print written as Python escapes it.

    Control characters, C1 among them, direction marks, separators of lines and halves of surrogate
    pairs do not print: ESC becomes `\x1b`, U+202E becomes `\u202e`, and the byte FF of a file name
    that is no UTF-8 becomes `\xff`. A space of any script prints.

    Args:
        text: Text from an untrusted source.
        keep: Characters that stay although they do not print.
        limit: Characters that remain at most, the mark of the cut included; None: all.
    """
    if limit is not None:
        text = text[: limit + 1]
    escaped = text if text.isprintable() else "".join(_visible(char, keep) for char in text)
    if limit is None or len(escaped) <= limit:
        return escaped
    return escaped[: limit - len(_MARK)] + _MARK


def _visible(char: str, keep: str) -> str:
    if char.isprintable() or char in keep or unicodedata.category(char) == "Zs":
        return char  # Zs: spaces of other scripts
    if ord(char) in _BYTES:
        return f"\\x{ord(char) - 0xDC00:02x}"
    return char.encode("unicode_escape").decode()
