"""What the wire page states of keys and files is what the code does."""

import re
from pathlib import Path

import pytest

from schemas.jsonschema import PUBLISHED, schema_file
from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys

PAGE = (Path(__file__).parents[3] / "schemas" / "WIRE.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(
    r"^\| `([^`]+)` \| `([^`]+)` \| `(counterpoint/v1/scene/[^`]+)` \|$", PAGE, re.M
)


def test_the_page_has_worked_examples() -> None:
    assert len(EXAMPLES) == 3


@pytest.mark.parametrize(("log_id", "scene_id", "key"), EXAMPLES)
def test_a_worked_example_is_right_both_ways(log_id: str, scene_id: str, key: str) -> None:
    assert keys.scene(root="counterpoint", log_id=log_id, scene_id=scene_id) == key
    assert keys.scene_id_of(key, root="counterpoint") == scene_id


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_page_links_every_schema_and_names_it(name: str) -> None:
    assert f"({schema_file(name).name})" in PAGE
    assert f"{name.removeprefix('counterpoint.')}`]" in PAGE


def test_the_page_knows_how_large_a_record_may_be() -> None:
    assert f"at most {MAX_RECORD_BYTES:,} bytes" in PAGE
