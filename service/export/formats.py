"""Every format of a selection: one row each. A new one is a file in this folder and a row."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final

from service.curation.selection import Selection
from service.export.json_lines import json_lines

FORMATS: Final[Mapping[str, Callable[[Selection], Iterator[str]]]] = {
    "json": json_lines,
}
"""By the option of `counterpoint select` that asks for it: writes a selection, best scene first, as
lines with their ends."""
