"""A whole review by keyboard: filter, scrub, orbit, twenty verdicts, undo, a second reviewer."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from service.store.engine import open_store
from tests.browser.conftest import Review, opened
from tests.browser.scene_overlay import FRAMES, state_with_points
from tests.browser.test_scene_page import at, drawn, ids, named, pixels
from tests.contracts.ledger_world import World

pytestmark = pytest.mark.browser

SCENES = 20
_FEWEST = 2
"""Keys of a verdict: a digit and Enter."""


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "state"
    state_with_points(folder)
    return folder


def add_scenes(review: Review) -> None:
    """Add logs, so that there are twenty scenes; those of later logs have no points."""
    store = open_store(review.state)
    world = World.on(store)
    world.listed("car-7/a", "car-9/b", "car-9/c")
    world.mine_all()
    store.close()
    assert len(ids(review)) >= SCENES


def ready(page: Page) -> None:
    """Wait until the page takes keys, with or without points."""
    expect(page.locator("html")).to_have_attribute("data-keys", "ready")


def judge_all(page: Page, verdict_of: dict[str, str], count: int) -> int:
    """Judge scene after scene by two keys; return the number of keys."""
    keys = 0
    for number in range(count):
        ready(page)
        scene = page.locator("input[name=scene_id]").first.input_value()
        page.keyboard.press(verdict_of[scene])
        keys += 1
        page.keyboard.press("Enter")
        keys += 1
        if number < count - 1:
            expect(page.locator("input[name=scene_id]").first).not_to_have_value(scene)
    return keys


def test_twenty_scenes_are_judged_by_two_reviewers_and_their_agreement_is_shown(
    browser: Browser, review: Review
) -> None:
    add_scenes(review)
    scenes = ids(review)[:SCENES]
    ada = {scene: "1" if number % 2 else "4" for number, scene in enumerate(scenes)}
    bob = ada | {scenes[0]: "1", scenes[1]: "4"}
    review.client("maker").post("/selections", how="filters", budget=str(SCENES), name="week")
    for name, verdict_of in (("Ada", ada), ("Bob", bob)):
        with opened(browser, review, at(scenes[0], "&selection=week")) as page:
            named(page, name)
            expect(page.locator("#progress")).to_contain_text(f"0 of {SCENES}")
            assert judge_all(page, verdict_of, SCENES) == _FEWEST * SCENES
            expect(page.locator("#status")).to_contain_text("every scene of the list is judged")
            expect(page.locator("#progress")).to_contain_text(f"{SCENES} of {SCENES}")
            page.goto("/agreement?selection=week")
            if name == "Bob":
                row = page.locator("tr", has_text="Ada and Bob")
                expect(row).to_contain_text(re.compile(r"20\s*18\s*0\.80"))
                expect(page.locator("#conflicts + .card tr")).to_have_count(2)


def test_a_scene_is_found_looked_at_judged_and_taken_back_without_a_mouse(
    browser: Browser, review: Review
) -> None:
    with opened(browser, review) as page:
        named(page, "Ada")
        ready(page)
        page.keyboard.press("/")
        page.keyboard.type("car static")
        page.keyboard.press("Enter")
        expect(page.locator(".chip")).to_have_count(1)
        ready(page)
        page.keyboard.press("j")
        page.keyboard.press("Enter")
        drawn(page, FRAMES - 1)
        page.keyboard.press("Home")
        drawn(page, 0)
        before = pixels(page)
        for key in ("a", "a", "w", "+"):
            page.keyboard.press(key)
        page.wait_for_timeout(80)
        assert pixels(page) != before, "it orbits"
        here = page.url.partition("&")[0]
        page.keyboard.press("1")
        page.keyboard.press("3")
        page.keyboard.press("Enter")
        page.wait_for_url(lambda url: url.partition("&")[0] != here)
        expect(page.locator("#progress")).to_contain_text("1 judged")
        page.keyboard.press("Control+z")
        expect(page.locator("#status")).to_contain_text("is undone")
        assert page.url.partition("&")[0] == here
        page.keyboard.press("Escape")
        expect(page.locator(".chip")).to_have_count(1)


def test_a_tab_of_an_earlier_record_keeps_its_verdict_next_to_the_new_record(
    browser: Browser, review: Review
) -> None:
    scene = ids(review)[0]
    with opened(browser, review, at(scene)) as page:
        named(page, "Ada")
        drawn(page)
        store = open_store(review.state)
        World.on(store).mine_all("p2")
        store.close()
        page.keyboard.press("1")
        page.keyboard.press("Enter")
        expect(page.locator("#status")).to_contain_text("saved for the record that you saw")
        page.goto(at(scene))
        expect(page.locator(".given.mine")).to_contain_text("on an earlier record")


def test_a_tab_whose_page_is_of_another_state_stores_nothing(
    browser: Browser, review: Review
) -> None:
    page = browser.new_page(base_url=review.url)
    page.goto(at(ids(review)[0]))
    named(page, "Ada")
    drawn(page)
    page.evaluate("() => { document.querySelector('#judge [name=token]').value = 'f'.repeat(64) }")
    page.keyboard.press("1")
    page.keyboard.press("Enter")
    expect(page.locator("#status")).to_contain_text("this form belongs to another state")
    page.close()
    rows = review.client("b").scenes()
    assert all(not row["verdicts"]["supervised"] for row in rows)  # type: ignore[index]
