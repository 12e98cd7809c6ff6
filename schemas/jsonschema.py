"""The JSON schema of a scored scene, for readers in other languages.

Records are canonical JSON, so any language reads them; the schema file in this folder says what is
in them. `python -m schemas.jsonschema` writes it; a test fails when it lags behind the models.
"""

import json
from pathlib import Path
from typing import Final

from schemas.score import SceneScore

SCENE_SCORE_SCHEMA: Final = Path(__file__).with_name("scene_score.v1.schema.json")


def scene_score_schema() -> str:
    """Return the text of the schema file, as `SceneScore` defines it."""
    schema = SceneScore.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["$id"] = "counterpoint.scene_score.v1"
    return json.dumps(schema, indent=2, sort_keys=True) + "\n"


def main() -> None:
    """Write the schema file anew."""
    SCENE_SCORE_SCHEMA.write_text(scene_score_schema(), encoding="utf-8")


if __name__ == "__main__":
    main()
