"""Text of others made fit to be shown: no control character reaches a terminal or a database."""

import re
from typing import Final

_CONTROLS: Final = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters, line separators, overrides of the direction of writing, and bytes that are
no UTF-8, which Python holds as surrogates."""

_MARK: Final = "…"


def has_controls(text: str) -> bool:
    """Return whether a text holds a character that a terminal may act on, or that is no UTF-8."""
    return _CONTROLS.search(text) is not None


def printable(text: str, *, limit: int) -> str:
    """Return the text with control characters escaped as in Python, cut to a length.

    Args:
        text: From a file, a bucket or a log.
        limit: Characters that remain at most, the mark of the cut included.
    """
    escaped = _CONTROLS.sub(_escape, text[: limit + 1])
    return escaped if len(escaped) <= limit else escaped[: limit - len(_MARK)] + _MARK


def _escape(found: re.Match[str]) -> str:
    code = ord(found.group())
    if 0xDC80 <= code <= 0xDCFF:  # a byte that is no UTF-8, as the file system gave it
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
