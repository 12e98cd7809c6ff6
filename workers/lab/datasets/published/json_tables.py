"""Large JSON tables of nuScenes, row by row, so that memory does not grow with the data set."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from workers.lab.datasets.conversion.source import DatasetUnusableError

_BLOCK: Final = 1 << 20
"""Characters that are read at once; a row of nuScenes has a few hundred."""


def rows_in(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a JSON array of objects.

    Raises:
        DatasetUnusableError: If the file is missing or cut, or a row is no object.
    """
    if not path.is_file():
        raise DatasetUnusableError(f"no such table: {path}")
    decoder, pending, started = json.JSONDecoder(), "", False
    with path.open(encoding="utf-8") as file:
        while True:
            block = file.read(_BLOCK)
            pending = (pending + block).lstrip()
            if not started and pending:
                if pending[0] != "[":
                    raise DatasetUnusableError(f"no JSON array: {path}")
                pending, started = pending[1:].lstrip(), True
            while pending and pending[0] != "]":
                try:
                    row, end = decoder.raw_decode(pending)
                except ValueError:
                    break
                if not isinstance(row, dict):
                    raise DatasetUnusableError(f"a row is no object ({path})")
                yield row
                pending = pending[end:].lstrip().removeprefix(",").lstrip()
            if pending.startswith("]"):
                return
            if not block:
                raise DatasetUnusableError(f"the table is cut: {path}")
