"""Values of settings, shown to people, without the password of any URL."""

import re
from typing import Final

_USER_AND_PASSWORD: Final = re.compile(r"(?<=://)([^/@\s:]*):\S*@")
"""Up to the last @, since a password may have a / without percent-encoding."""

_PASSWORD_PARAMETER: Final = re.compile(r"(?i)((?:password|secret|token)[a-z_]*=)[^&\s;]+")

MOST_IN_SENTENCE: Final = 500
"""Characters of a value in a sentence; a longer one has its middle left out."""


def in_sentence(value: object) -> str:
    """Format a value for a sentence, as `shown` does, without the middle of a long one."""
    text = shown(value)
    if len(text) <= MOST_IN_SENTENCE:
        return text
    half = MOST_IN_SENTENCE // 2
    return f"{text[:half]} … {text[-half:]} ({len(text):,} characters)"


def shown(value: object) -> str:
    """Format a value without the password of any URL in it."""
    if isinstance(value, list | tuple):
        return ", ".join(map(shown, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return _PASSWORD_PARAMETER.sub(r"\1***", _USER_AND_PASSWORD.sub(r"\1:***@", text))
