"""Format `json`: a selection as JSON lines."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from service.curation.selection import Selection
from service.export.format import Format
from service.export.scene import SceneToExport


def json_lines(selection: Selection) -> Iterator[str]:
    """Yield a line for each scene: its row of the ranking, with the selection and its strategy."""
    about = {"selection": selection.name, "strategy": selection.strategy}
    for row in selection.scenes:
        yield json.dumps(about | row.model_dump(mode="json")) + "\n"


def _write_all(selection: Selection, scenes: Sequence[SceneToExport], folder: Path) -> None:
    verdicts = {each.row.scene_id: each.verdicts for each in scenes}
    with (folder / "scenes.jsonl").open("w", encoding="utf-8") as file:
        for line in json_lines(selection):
            row = json.loads(line)
            told = [each.model_dump() for each in verdicts.get(row["scene_id"], ())]
            file.write(json.dumps(row | {"verdicts": told}) + "\n")


JSON: Final = Format(
    name="json",
    text="One line of JSON for each scene, as `select --json` prints it, with the verdicts.",
    write_all=_write_all,
)
"""The rows of the selection."""
