import json

from schemas.jsonschema import SCENE_SCORE_SCHEMA, scene_score_schema
from schemas.score import SceneScore


def test_the_schema_file_is_what_the_models_say() -> None:
    assert SCENE_SCORE_SCHEMA.read_text(encoding="utf-8") == scene_score_schema(), (
        "the model of a scored scene changed: run `python -m schemas.jsonschema`, "
        "and raise schema_version if old readers would break"
    )


def test_the_schema_file_carries_the_version_of_the_records() -> None:
    version = SceneScore.model_fields["schema_version"].default
    assert f".v{version}." in SCENE_SCORE_SCHEMA.name
    schema = json.loads(SCENE_SCORE_SCHEMA.read_text(encoding="utf-8"))
    assert schema["properties"]["schema_version"]["const"] == version


def test_every_field_of_a_record_says_what_it_means() -> None:
    schema = json.loads(scene_score_schema())
    undescribed = {
        name
        for name, field in schema["properties"].items()
        if "description" not in field and "$ref" not in field
    }
    assert undescribed == {"schema_version"}
