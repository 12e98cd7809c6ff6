import json

import pytest

from schemas.jsonschema import PUBLISHED, schema_file, schema_text
from schemas.score import SceneScore


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_schema_file_is_what_the_model_says(name: str) -> None:
    assert schema_file(name).read_text(encoding="utf-8") == schema_text(name), (
        "the model of what is published changed: run `python -m schemas.jsonschema`, "
        "and raise the version if old readers would break"
    )


def test_the_schema_file_carries_the_version_of_the_records() -> None:
    version = SceneScore.model_fields["schema_version"].default
    file = schema_file(f"counterpoint.scene_score.v{version}")
    schema = json.loads(file.read_text(encoding="utf-8"))
    assert schema["properties"]["schema_version"]["const"] == version


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_reader_may_meet_fields_of_a_later_service(name: str) -> None:
    assert '"additionalProperties": false' not in schema_text(name)


@pytest.mark.parametrize("name", PUBLISHED)
def test_every_field_says_what_it_means(name: str) -> None:
    undescribed = {
        field
        for field, about in json.loads(schema_text(name))["properties"].items()
        if "description" not in about and "$ref" not in about
    }
    assert undescribed == ({"schema_version"} if name == "counterpoint.scene_score.v2" else set())


def test_the_schema_of_version_1_stays_for_what_was_stored_by_it() -> None:
    schema = json.loads(schema_file("counterpoint.scene_score.v1").read_text(encoding="utf-8"))
    assert schema["properties"]["schema_version"]["const"] == 1
    assert schema["properties"]["reasons"]["items"]["type"] == "string"
