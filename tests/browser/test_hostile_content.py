"""Records and reviewers whose texts are HTML: each page shows them as text, and runs nothing."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from schemas.score import Reason
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from tests.browser.conftest import Review, opened
from tests.browser.scene_overlay import overlay_with_points, two_tracks
from tests.browser.test_scene_page import at, drawn, ids, named
from tests.unit.service.mined_state import mined_state

pytestmark = pytest.mark.browser

HTML = '<img src=x onerror="window.ran=1"></script><script>window.ran=1</script>\''
CONTROL = "\x1b[2J\u202e"


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile") / "state"
    fields = two_tracks()
    fields["tracks"] = tuple(
        track.model_copy(update={"class_name": HTML}) for track in fields["tracks"]
    )
    fields["reasons"] = (Reason(headline=f"supervised labels {HTML} static", track_id=0),)
    vehicle = f"{HTML}{CONTROL}"
    for path in mined_state(folder, log_id="car-7/a'<b>\"", vehicle=vehicle, **fields):
        scene_id = decode_overlay(path.read_bytes()).scene_id
        start_ns = int(scene_id.rpartition("/")[2])
        path.write_bytes(encode_overlay(overlay_with_points(scene_id, start_ns)))
    return folder


def test_html_of_records_and_reviewers_is_text_on_every_page(
    browser: Browser, review: Review
) -> None:
    scene = ids(review)[0]
    ada = review.client(f"Ada {HTML}")
    assert ada.post("/selections", how="filters", budget="2", name="week") == 303
    fields = {"scene_id": scene, "verdict": "supervised", "note": HTML}
    assert ada.post("/verdict", **fields) == 303
    paths = ("/", at(scene), "/dashboard", "/selections", "/agreement")
    with opened(browser, review) as page:
        named(page, f"Bob {HTML}")
        for path in paths:
            page.goto(path)
            if path == at(scene):
                drawn(page)
                page.keyboard.press("4")
                page.keyboard.press("n")
                page.keyboard.type(HTML)
                page.keyboard.press("Enter")
                expect(page.locator("#progress")).to_contain_text("1 judged")
                page.goto(path)
                drawn(page)
                expect(page.locator(".given.mine")).to_contain_text(HTML)
            expect(page.locator("body")).to_contain_text("<img src=x")
            assert "\x1b" not in page.content()
            assert "\u202e" not in page.content()
            assert page.evaluate("window.ran") is None
