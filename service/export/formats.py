"""Every format of a selection: one row each. A new one is a file in this folder and a row."""

from collections.abc import Mapping
from typing import Final

from service.errors import UsageError
from service.export.format import Format
from service.export.json_lines import JSON
from service.export.mcap_excerpt import MCAP

FORMATS: Final[Mapping[str, Format]] = {each.name: each for each in (JSON, MCAP)}
"""By the name that `counterpoint export --format` takes."""


def format_named(name: str) -> Format:
    """Find a format.

    Raises:
        UsageError: If there is none of that name.
    """
    found = FORMATS.get(name)
    if found is None:
        raise UsageError(f"no format {name!r}: --format is one of {', '.join(FORMATS)}")
    return found
