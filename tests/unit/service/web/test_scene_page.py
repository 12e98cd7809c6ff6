"""Routes of the scene page: blocks as stored, records without overlay, withdrawn scenes, links."""

import tracemalloc
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

import pytest
import zstandard

from schemas.surroundings import ScenePlace
from schemas.transport.overlay_codec import overlay_file_of
from service.store.engine import open_store
from service.web.scene_links import links_of, rfc3339
from tests.browser.scene_overlay import overlay_path, state_with_points
from tests.contracts.ledger_world import World
from tests.unit.service.mined_state import mined_state
from tests.unit.service.web.page import Page


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "state"
    state_with_points(folder)
    return folder


def first(page: Page) -> tuple[str, str]:
    row = page.scenes()[0]
    return str(row["scene_id"]), str(row["sha256"])


def data(kind: str, scene_id: str, digest: str, n: int = 0) -> str:
    return f"/data/{kind}?id={quote(scene_id, safe='')}&digest={digest}&n={n}"


def test_blocks_are_passed_on_as_stored_and_kept_by_browsers(page: Page, state: Path) -> None:
    scene_id, digest = first(page)
    stored = overlay_file_of(overlay_path(state, scene_id).read_bytes())
    for kind, block in (("frame", stored.view(1)), ("rest", stored.rest(1))):
        answer = page.get(data(kind, scene_id, digest, 1), headers={"accept-encoding": "gzip"})
        assert answer.content == block
        assert "content-encoding" not in answer.headers
        assert answer.headers["vary"] == "accept-encoding"
        assert "immutable" in answer.headers["cache-control"]
        again = page.get(
            data(kind, scene_id, digest, 1),
            headers={"accept-encoding": "gzip", "if-none-match": answer.headers["etag"]},
        )
        assert (again.status_code, again.content) == (304, b"")


def test_of_an_overlay_of_300_megabytes_only_the_asked_block_is_read(
    page: Page, state: Path
) -> None:
    scene_id, digest = first(page)
    path = overlay_path(state, scene_id)
    block = overlay_file_of(path.read_bytes()).view(1)
    with path.open("r+b") as file:
        file.truncate(300_000_000)
    tracemalloc.start()
    try:
        assert page.get(data("frame", scene_id, digest, 1)).status_code == 200
        assert page.get(f"/scene?id={quote(scene_id, safe='')}").status_code == 200
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 30_000_000 + len(block)


def test_browsers_that_ask_undo_zstd_themselves(page: Page) -> None:
    scene_id, digest = first(page)
    plain = page.get(data("frame", scene_id, digest), headers={"accept-encoding": "gzip"})
    asked = page.get(data("frame", scene_id, digest), headers={"accept-encoding": "gzip, zstd"})
    assert asked.headers["content-encoding"] == "zstd"
    assert asked.headers["etag"] != plain.headers["etag"]
    assert zstandard.ZstdDecompressor().decompressobj().decompress(plain.content)


def test_a_picture_is_sent_with_its_media_type(page: Page) -> None:
    scene_id, digest = first(page)
    answer = page.get(data("image", scene_id, digest))
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.content[:2] == b"\xff\xd8"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"n": 99}, "no view 99: this scene has 5"),
        ({"digest": "0" * 64}, "mined again"),
        ({"scene_id": "car-7/../../etc/passwd"}, "no current scene"),
    ],
)
def test_what_is_not_there_is_answered_with_a_sentence(
    page: Page, change: dict[str, Any], words: str
) -> None:
    scene_id, digest = first(page)
    answer = page.get(data(**({"kind": "frame", "scene_id": scene_id, "digest": digest} | change)))
    assert answer.status_code == 404
    assert words in answer.json()["problem"]


def test_the_data_of_a_scene_have_record_header_and_neighbours(page: Page) -> None:
    scene_id, digest = first(page)
    facts = page.get(f"/data/scene?id={quote(scene_id, safe='')}").json()
    assert facts["sha256"] == digest
    assert facts["record"]["scene_id"] == scene_id
    assert len(facts["overlay"]["frames"]) == 5
    assert {row["scene_id"] for row in facts["neighbours"]} == {
        str(row["scene_id"]) for row in page.scenes()
    } - {scene_id}


def test_a_withdrawn_scene_is_readable_and_can_be_judged(page: Page, state: Path) -> None:
    scene_id, digest = first(page)
    store = open_store(state)
    World.on(store).listed("car-9/other")
    store.close()
    page.as_reviewer("ana")
    assert page.scenes() == []
    text = page.get(f"/scene?id={quote(scene_id, safe='')}").text
    assert "This scene is withdrawn" in text
    assert "Evidence for" in text
    fields = {"scene_id": scene_id, "sha256": digest, "verdict": "both", "key": "w1"}
    answer = page.post_json("/verdict", fields)
    assert answer.status_code == 200, answer.text
    assert answer.json()["stored"]["record"] == "withdrawn"


def test_html_of_a_record_is_text(page: Page, state: Path) -> None:
    scene_id, _ = first(page)
    fields = {"scene_id": scene_id, "verdict": "unsure", "note": "</script><b>x</b>", "key": "h1"}
    page.as_reviewer("ana").post_json("/verdict", fields)
    text = page.get(f"/scene?id={quote(scene_id, safe='')}").text
    assert "<b>x</b>" not in text
    assert "&lt;b&gt;x&lt;/b&gt;" in text


def test_browsers_open_logs_of_an_http_bucket_at_the_second() -> None:
    links = links_of("https://logs.example/fleet/", "car 7/a", 1_700_000_000_123_456_789)
    assert [name for name, _ in links.web] == ["Foxglove", "Lichtblick"]
    for _, href in links.web:
        asked = parse_qs(urlsplit(href).query)
        assert asked["ds"] == ["remote-file"]
        assert asked["ds.url"] == ["https://logs.example/fleet/car%207/a.mcap"]
        assert asked["time"] == ["2023-11-14T22:13:20.123456789Z"]


def test_other_logs_have_a_command_whose_names_are_quoted() -> None:
    local = links_of("/data/logs", "car 7/a;b", 0)
    assert local.web == ()
    assert local.commands == ("rerun '/data/logs/car 7/a;b.mcap'",)
    cloud = links_of("s3://fleet/logs", "car-7/a", 0)
    assert cloud.commands == ("aws s3 cp s3://fleet/logs/car-7/a.mcap . && rerun a.mcap",)


def test_an_instant_keeps_its_nanoseconds() -> None:
    assert rfc3339(1_700_000_000_000_000_001).endswith(".000000001Z")


def test_a_scene_page_states_the_place_as_text(tmp_path: Path) -> None:
    frame = "<b>map</b>"
    place = ScenePlace(frame=frame, x_m=690_000.04, y_m=5.0, odom_m=(0.0, 0.0))
    mined_state(tmp_path / "metres", place=place)
    on_earth = ScenePlace(latitude_deg=48.137123, longitude_deg=11.5, odom_m=(0.0, 0.0))
    mined_state(tmp_path / "earth", place=on_earth)
    for folder, shown in (
        ("metres", "&lt;b&gt;map&lt;/b&gt; 690000.0, 5.0"),
        ("earth", "48.137123, 11.500000"),
    ):
        page = Page(tmp_path / folder)
        scene_id, _ = first(page)
        assert shown in page.get(f"/scene?id={quote(scene_id, safe='')}").text
