"""A selection as JSON lines."""

import json
from collections.abc import Iterator

from service.curation.selection import Selection


def json_lines(selection: Selection) -> Iterator[str]:
    """Yield a line for each scene: its row of the ranking, with the selection and its strategy."""
    about = {"selection": selection.name, "strategy": selection.strategy}
    for row in selection.scenes:
        yield json.dumps(about | row.model_dump(mode="json")) + "\n"
