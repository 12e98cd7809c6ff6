"""The scene page in a browser: the view, the verdict by keyboard, links, and broken overlays."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from schemas.task import MOTION
from schemas.transport.overlay_blocks import view_points
from schemas.transport.overlay_codec import decode_overlay, overlay_file_of
from tests.browser.conftest import PHONE, Review, opened
from tests.browser.scene_overlay import FRAMES, overlay_path, state_with_points
from workers.lab.evaluation.benchmarks.bench_overlay import encode_version_1

pytestmark = pytest.mark.browser


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "state"
    state_with_points(folder)
    return folder


def ids(review: Review) -> list[str]:
    return [str(row["scene_id"]) for row in review.client("counter").scenes()]


def at(scene_id: str, rest: str = "") -> str:
    return f"/scene?id={scene_id.replace('/', '%2F')}{rest}"


def drawn(page: Page, frame: int | None = None) -> None:
    """Wait until a frame is drawn with its points."""
    wanted = r"\d+" if frame is None else str(frame)
    expect(page.locator("html")).to_have_attribute("data-drawn", re.compile(f"^{wanted}$"))


def pixels(page: Page, pane: str = "#left") -> str:
    return str(page.locator(pane).evaluate("canvas => canvas.toDataURL()"))


def until(page: Page, condition: Callable[[], bool], what: str) -> None:
    """Wait for the next drawing of a view, which a busy machine delays."""
    end_s = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end_s, what
        page.wait_for_timeout(20)


def fits(page: Page, pane: str = "#left") -> bool:
    """Return true if a view has been drawn in the size of its place."""
    size = "canvas => canvas.width === Math.round(canvas.clientWidth * devicePixelRatio)"
    return bool(page.locator(pane).evaluate(size))


def named(page: Page, name: str = "ana") -> None:
    page.locator("#who summary").click()
    page.get_by_label("Reviewer").fill(name)
    page.locator("#who").get_by_role("button", name="Save").click()
    expect(page.locator("#who summary")).to_have_text(name)


def test_a_scene_opens_at_its_strongest_moment_and_is_scrubbed(
    browser: Browser, review: Review
) -> None:
    with opened(browser, review, at(ids(review)[0])) as page:
        drawn(page, FRAMES - 1)
        expect(page.get_by_role("heading", level=1)).to_have_text("supervised labels car static")
        before = pixels(page)
        page.keyboard.press("ArrowLeft")
        drawn(page, FRAMES - 2)
        assert pixels(page) != before
        page.keyboard.press("Home")
        drawn(page, 0)
        page.get_by_label("Frame", exact=True).fill("3")
        drawn(page, 3)
        expect(page).to_have_url(re.compile(r"frame=3&track=0"))
        page.keyboard.press("Space")
        expect(page.get_by_role("button", name="Pause")).to_be_visible()


def test_the_view_turns_zooms_and_changes_by_key(browser: Browser, review: Review) -> None:
    with opened(browser, review, at(ids(review)[0])) as page:
        drawn(page)
        seen = {pixels(page)}
        for key in ("a", "w", "+", "x", "c", "g", "o", "e", "f"):
            page.keyboard.press(key)
            if key in ("g", "f"):
                page.wait_for_timeout(60)
            else:
                until(page, lambda: pixels(page) not in seen, key)
            seen.add(pixels(page))
        page.keyboard.press("l")
        expect(page.locator("#right-name")).to_have_text("Self-supervised labels")
        page.keyboard.press("Escape")
        expect(page.locator("#right-name")).to_be_hidden()
        until(page, lambda: fits(page), "the view takes the room of the other one")
        before = pixels(page)
        page.keyboard.down("v")
        until(page, lambda: pixels(page) != before, "the view while the key is down")
        page.keyboard.up("v")
        until(page, lambda: pixels(page) == before, "the view of before")
        page.mouse.move(300, 400)
        page.mouse.down()
        page.mouse.move(360, 430)
        page.mouse.up()
        until(page, lambda: pixels(page) != before, "the view that was turned")


def test_safe_colours_are_those_of_boxes_and_cards_and_stay_chosen(
    browser: Browser, review: Review
) -> None:
    def colour(page: Page) -> str:
        number = page.locator(".track .number").first
        return str(number.evaluate("each => getComputedStyle(each).backgroundColor"))

    scenes = ids(review)
    with opened(browser, review, at(scenes[0])) as page:
        drawn(page)
        usual = colour(page)
        page.keyboard.press("c")
        safe = page.get_by_role("button", name="Safe colours")
        expect(safe).to_have_attribute("aria-pressed", "true")
        assert colour(page) != usual
        page.goto(at(scenes[1]))
        drawn(page)
        expect(safe).to_have_attribute("aria-pressed", "true")
        page.keyboard.press("c")
        page.goto(at(scenes[0]))
        drawn(page)
        expect(safe).to_have_attribute("aria-pressed", "false")
        assert colour(page) == usual


def test_two_runs_draw_the_same_pixels(browser: Browser, review: Review) -> None:
    runs = []
    for _ in range(2):
        with opened(browser, review, at(ids(review)[0])) as page:
            drawn(page)
            page.wait_for_timeout(300)
            runs.append((pixels(page), pixels(page, "#right")))
    assert runs[0] == runs[1]


def test_a_deep_link_opens_frame_and_track(browser: Browser, review: Review) -> None:
    with opened(browser, review, at(ids(review)[0], "&frame=1&track=1")) as page:
        drawn(page, 1)
        expect(page.locator("details.track[open] .what")).to_contain_text("pedestrian")
        page.keyboard.press("[")
        expect(page).to_have_url(re.compile("track=0"))
        expect(page.locator("#pictures canvas").first).to_be_visible()


def test_every_scene_is_judged_by_keyboard_and_a_verdict_undone(
    browser: Browser, review: Review
) -> None:
    scenes = ids(review)
    with opened(browser, review, at(scenes[0])) as page:
        named(page)
        for number in range(len(scenes)):
            drawn(page)
            here = page.url
            page.keyboard.press(str(1 + number % 4))
            page.keyboard.press("2")
            page.keyboard.press("Enter")
            if number < len(scenes) - 1:
                expect(page).not_to_have_url(re.compile(re.escape(here.partition("&frame")[0])))
        expect(page.locator("#status")).to_contain_text("every scene of the list is judged")
        page.keyboard.press("Control+z")
        expect(page.locator("#status")).to_contain_text("is undone")
        expect(page.locator(".given.mine")).to_have_count(0)
    rows = review.client("ana").scenes()
    assert sum(row["verdicts"]["mine"] is None for row in rows) == 1  # type: ignore[index]


@pytest.fixture
def own_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_CAUSES", "tram,steam")


@pytest.mark.usefixtures("own_causes", "review")
def test_a_cause_of_the_users_own_list_has_a_key(browser: Browser, review: Review) -> None:
    with opened(browser, review, at(ids(review)[0])) as page:
        named(page)
        drawn(page)
        for key, cause in (("1", None), ("m", "tram"), ("m", "steam"), ("m", "tram")):
            page.keyboard.press(key)
            if cause:
                expect(page.locator("input[name=cause]:checked")).to_have_value(cause)
        page.keyboard.press("Enter")
        expect(page.locator("#progress")).to_contain_text("1 judged")
        drawn(page)  # the next scene, whose keys work from now on
        page.keyboard.press("Control+z")
        expect(page.locator("#status")).to_contain_text("is undone")


def test_enter_goes_to_the_next_scene_that_this_reviewer_has_not_judged(
    browser: Browser, review: Review
) -> None:
    scenes = ids(review)[:3]
    for name in ("ana", "bob"):  # what the first one judged is still to be judged by the second
        with opened(browser, review, at(scenes[0])) as page:
            named(page, name)
            drawn(page)
            for following in scenes[1:]:
                page.keyboard.press("1")
                page.keyboard.press("Enter")
                expect(page).to_have_url(re.compile(re.escape(following.replace("/", "%2F"))))
                drawn(page)


def test_a_track_is_judged_with_a_note_and_others_see_it_folded(
    browser: Browser, review: Review
) -> None:
    scene = ids(review)[0]
    with opened(browser, review, at(scene)) as page:
        named(page)
        drawn(page)
        page.keyboard.press("]")
        page.keyboard.press("0")
        page.keyboard.press("4")
        page.keyboard.press("n")
        page.keyboard.type("1 child <b>behind</b> a bin")
        page.keyboard.press("Enter")
        expect(page.locator("#status")).to_contain_text("saved for track 2")
        expect(page.locator(".given.mine")).to_contain_text("neither wrong")
        expect(page.locator(".given.mine")).to_contain_text("track 2")
        expect(page.locator(".given.mine q")).to_have_text("1 child <b>behind</b> a bin")
    with opened(browser, review, at(scene)) as page:
        named(page, "bob")
        expect(page.get_by_text("1 verdict of others")).to_be_visible()
        expect(page.get_by_text("1 child")).to_be_hidden()


def test_a_duplicate_names_the_scene_that_shows_the_same(browser: Browser, review: Review) -> None:
    scene, other = ids(review)[:2]
    with opened(browser, review, at(scene)) as page:
        named(page)
        drawn(page)
        expect(page.get_by_label("Shows the same as")).to_be_hidden()
        page.keyboard.press("6")
        page.get_by_label("Shows the same as").select_option(value=other)
        page.get_by_role("button", name="Save").last.click()
        page.wait_for_url(lambda url: scene.replace("/", "%2F") not in url)
    (row,) = [row for row in review.client("bob").scenes() if row["scene_id"] == scene]
    verdicts: Any = row["verdicts"]
    assert verdicts["duplicate"] == 1


def test_tab_leaves_the_canvas_and_keys_stay_out_of_fields(
    browser: Browser, review: Review
) -> None:
    with opened(browser, review, at(ids(review)[0])) as page:
        drawn(page)
        page.locator("#left").focus()
        for _ in range(2):
            page.keyboard.press("Tab")
        expect(page.locator("#left")).not_to_be_focused()
        page.locator("input[name=note]").focus()
        page.keyboard.type("lt1")
        expect(page.locator("input[name=note]")).to_have_value("lt1")
        expect(page.locator("input[name=verdict]:checked")).to_have_count(0)


def test_without_script_the_picture_and_the_form_work(browser: Browser, review: Review) -> None:
    scene = ids(review)[0]
    with opened(browser, review, at(scene), script=False) as page:
        expect(page.locator("img.drawn")).to_have_js_property("naturalWidth", 1720)
        page.locator("label.self_supervised").click()
        page.locator("label.choice", has_text="occlusion").click()
        page.get_by_label("Your name").fill("ana")
        page.get_by_role("button", name="Save").last.click()
        page.goto(at(scene))
        expect(page.locator(".given.mine")).to_contain_text("self-supervised wrong")
        page.get_by_role("button", name="Undo my verdict").click()
        expect(page.locator(".given.mine")).to_have_count(0)


@pytest.mark.parametrize("how", ["gone", "cut", "newer"])
def test_a_scene_without_its_points_is_shown_and_judged(
    browser: Browser, review: Review, how: str
) -> None:
    scene = ids(review)[0]
    path = overlay_path(review.state, scene)
    data = path.read_bytes()
    if how == "gone":
        path.unlink()
    else:
        path.write_bytes(data[:5000] if how == "cut" else data[:5] + b"9" + data[6:])
    words = {"gone": "no overlay", "cut": "unreadable", "newer": "update"}
    with opened(browser, review, at(scene)) as page:
        expect(page.locator(".stage")).to_contain_text(words[how])
        expect(page.get_by_text("Evidence for").first).to_be_visible()
        judged_unsure(page, scene)


def test_a_damaged_frame_is_named_and_the_scene_is_judged(browser: Browser, review: Review) -> None:
    scene = ids(review)[0]
    path = overlay_path(review.state, scene)
    last = overlay_file_of(path.read_bytes()).header.frames[-1]
    data = bytearray(path.read_bytes())
    data[last.view[0] + 40 : last.view[0] + 60] = bytes(20)
    path.write_bytes(data)
    page = browser.new_page(base_url=review.url)
    page.goto(at(scene))
    expect(page.locator("#loading")).to_contain_text("does not have its checksum")
    page.keyboard.press("ArrowLeft")
    drawn(page, FRAMES - 2)
    judged_unsure(page, scene)
    page.close()


def judged_unsure(page: Page, scene: str) -> None:
    page.get_by_label("Your name").fill("ana")
    page.locator("h1").click()
    page.keyboard.press("5")
    page.keyboard.press("Enter")
    page.wait_for_url(lambda url: scene.replace("/", "%2F") not in url)


def test_an_overlay_of_version_1_is_shown(browser: Browser, review: Review) -> None:
    scene = ids(review)[0]
    path = overlay_path(review.state, scene)
    path.write_bytes(encode_version_1(decode_overlay(path.read_bytes())))
    with opened(browser, review, at(scene)) as page:
        drawn(page)


def test_a_phone_shows_the_whole_page(browser: Browser, review: Review) -> None:
    with opened(browser, review, at(ids(review)[0]), size=PHONE) as page:
        drawn(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        expect(page.get_by_role("button", name="Save").last).to_be_visible()


def test_bytes_that_the_browser_left_compressed_are_decompressed_by_the_page(
    browser: Browser, review: Review
) -> None:
    def bare(route: Route) -> None:
        answer = httpx.get(route.request.url, headers={"accept-encoding": "identity"})
        route.fulfill(body=answer.content, content_type="application/octet-stream")

    with opened(browser, review) as page:
        page.route(re.compile("/data/frame"), bare)
        page.goto(at(ids(review)[0]))
        drawn(page, FRAMES - 1)


def test_the_page_decodes_what_python_encoded(browser: Browser, review: Review) -> None:
    scene = ids(review)[0]
    file = overlay_file_of(overlay_path(review.state, scene).read_bytes())
    count = file.header.frames[1].points
    known = view_points(file.view(1), count, MOTION.unknown)
    with opened(browser, review, at(scene)) as page:
        facts = page.evaluate(
            """async (count) => {
              const { decodeView } = await import("/static/viewer/codec.js");
              const { id, digest } = JSON.parse(document.querySelector("#facts").textContent);
              const address = `/data/frame?id=${encodeURIComponent(id)}&digest=${digest}&n=1`;
              const block = await (await fetch(address)).arrayBuffer();
              const frame = decodeView(new Uint8Array(block), count);
              return [frame.points, frame.members, frame.owners].map((each) => Array.from(each));
            }""",
            count,
        )
    points = np.array(facts[0]).reshape(-1, 4)
    np.testing.assert_array_equal(points[:, :3], known.points_cm)
    codes = points[:, 3]
    np.testing.assert_array_equal(codes & 15, known.semantic_labels)
    np.testing.assert_array_equal((codes >> 4) & 15, known.predictive_labels)
    np.testing.assert_array_equal(((codes >> 8) & 15) < 2, known.witness_labels < MOTION.unknown)
    np.testing.assert_array_equal((codes >> 12) & 1, known.ground_mask)
    assert facts[1:] == [known.instance_points.tolist(), known.instance_of.tolist()]
