"""A selection as JSON lines."""

import json
from collections.abc import Iterator

from service.curation.selection import Selection


def json_lines(selection: Selection) -> Iterator[str]:
    """Yield a line for each scene: its row of the ranking, and the name of the selection."""
    for row in selection.scenes:
        yield json.dumps({"selection": selection.name} | row.model_dump(mode="json")) + "\n"
