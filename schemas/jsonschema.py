"""JSON schemas of published messages, for readers in other languages.

Messages are canonical JSON, so any language reads them; the schema files in this folder describe
their fields. `python -m schemas.jsonschema` writes them; a test fails when they differ from the
models.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from schemas.events import RankedScene, SceneNumber
from schemas.predicted_boxes import PredictedBoxes
from schemas.problem import Problem
from schemas.score import SceneScore
from schemas.verdict import VerdictRecord

PUBLISHED: Final[Mapping[str, type[BaseModel]]] = {
    "counterpoint.scene_score.v2": SceneScore,
    "counterpoint.scene_number.v1": SceneNumber,
    "counterpoint.ranked_scene.v1": RankedScene,
    "counterpoint.verdict.v1": VerdictRecord,
    "counterpoint.problem.v1": Problem,
    "counterpoint.boxes.v1": PredictedBoxes,
}
"""Name of the schema, as encodings on the bus give it, to the model. `scene_score.v1` is kept as a
file only: stored records of that version are still published, and none is written."""


def schema_file(name: str) -> Path:
    """Return the path of the schema file of this name."""
    return Path(__file__).with_name(f"{name.removeprefix('counterpoint.')}.schema.json")


def schema_text(name: str) -> str:
    """Return the text of a schema file, as its model defines it.

    Models refuse unknown fields. Readers elsewhere must accept them: a later service may send more.
    """
    schema = _open(PUBLISHED[name].model_json_schema())
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["$id"] = name
    return json.dumps(schema, indent=2, sort_keys=True) + "\n"


def main() -> None:
    """Write the schema files."""
    for name in PUBLISHED:
        schema_file(name).write_text(schema_text(name), encoding="utf-8")


def _open(schema: Any) -> Any:
    if isinstance(schema, dict):
        return {
            key: _open(value)
            for key, value in schema.items()
            if (key, value) != ("additionalProperties", False)
        }
    if isinstance(schema, list):
        return [_open(value) for value in schema]
    return schema


if __name__ == "__main__":
    main()
