"""Values of settings, shown to people, without the password of any URL."""

import re
from typing import Final

_USER_AND_PASSWORD: Final = re.compile(r"(?<=://)([^/@\s:]*):\S*@")
"""Up to the last @, since a password may have a / without percent-encoding."""

_PASSWORD_PARAMETER: Final = re.compile(r"(?i)((?:password|secret|token)[a-z_]*=)[^&\s;]+")


def shown(value: object) -> str:
    """Format a value without the password of any URL in it."""
    if isinstance(value, list | tuple):
        return ", ".join(map(shown, value))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return _PASSWORD_PARAMETER.sub(r"\1***", _USER_AND_PASSWORD.sub(r"\1:***@", text))
