"""The ranking, filters, selections and forms in a browser: by keyboard, without script, live."""

import re

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.conftest import DESK, PHONE, Review, opened
from tests.unit.service.mined_state import scenes_at

pytestmark = pytest.mark.browser

PATHS = ("/", "/dashboard", "/selections", "/agreement")


def named(page: Page, name: str, budget: str = "") -> None:
    """Give the reviewer's name in the form at the top."""
    page.locator("#who summary").click()
    page.get_by_label("Reviewer").fill(name)
    page.get_by_label("Budget, scenes").first.fill(budget)
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#who summary")).to_have_text(name)


def test_the_list_is_walked_by_keyboard(browser: Browser, review: Review) -> None:
    with opened(browser, review) as page:
        cards = page.locator("a.headline")
        expect(cards.first).to_be_visible()
        page.keyboard.press("j")
        expect(cards.nth(0)).to_be_focused()
        page.keyboard.press("j")
        page.keyboard.press("j")
        page.keyboard.press("k")
        expect(cards.nth(1)).to_be_focused()
        page.keyboard.press("?")
        expect(page.locator("#help")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator("#help")).to_be_hidden()
        page.keyboard.press("/")
        expect(page.locator("#search")).to_be_focused()
        page.keyboard.type("jj?")
        expect(page.locator("#search")).to_have_value("jj?")
        expect(page.locator("#help")).to_be_hidden()


def test_thumbnails_are_drawn(browser: Browser, review: Review) -> None:
    with opened(browser, review) as page:
        image = page.locator(".scene img").first
        expect(image).to_have_js_property("complete", True)
        expect(image).to_have_js_property("naturalWidth", 352)


def test_a_filter_applies_at_once_and_its_chip_removes_it(browser: Browser, review: Review) -> None:
    review.add_log("car-9/b")
    with opened(browser, review) as page:
        every = page.locator(".scene").count()
        page.get_by_label("Kind").select_option(index=1)
        expect(page).to_have_url(re.compile(r"/\?kind=[^&]+$"))
        expect(page.locator(".chip")).to_have_count(1)
        page.get_by_label("Log", exact=True).fill("car-9/*")
        page.keyboard.press("Enter")
        expect(page.locator(".chip")).to_have_count(2)
        assert 0 < page.locator(".scene").count() < every
        page.locator(".chip").first.click()
        page.locator(".chip").first.click()
        expect(page.locator(".scene")).to_have_count(every)


@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_scenes_are_filtered_by_range(browser: Browser, review: Review, script: bool) -> None:
    scenes_at(review.state, 8.2, 24.0, 30.0, 41.5, 77.0)
    with opened(browser, review, script=script) as page:
        cards, chips = page.locator(".scene .headline"), page.locator(".chip")
        expect(cards).to_have_count(5)
        page.get_by_label("within, m").fill("30")
        page.keyboard.press("Enter")
        expect(page.locator("h1")).to_have_text("3 scenes")
        expect(cards).to_contain_text(["8 m ahead", "24 m ahead", "30 m ahead"])
        expect(chips).to_have_text([re.compile("^range within: 30 m")])
        page.get_by_label("Range beyond").fill("10")
        page.get_by_role("button", name="Apply").click()
        expect(cards).to_contain_text(["24 m ahead", "30 m ahead"])
        expect(page.get_by_label("within, m")).to_have_value("30")
        cards.first.click()
        page.get_by_role("link", name="List", exact=True).click()
        expect(cards).to_have_count(2)
        chips.last.click()
        expect(cards).to_contain_text(["24 m", "30 m", "42 m", "77 m"])
        page.get_by_role("link", name="Clear").click()
        expect(cards).to_have_count(5)


def test_new_scenes_appear_while_the_page_is_open(browser: Browser, review: Review) -> None:
    with opened(browser, review, "/?log=car-9/*") as page:
        expect(page.locator(".scene")).to_have_count(0)
        expect(page.locator("#live")).to_be_hidden()
        review.add_log("car-9/b")
        expect(page.locator("#live a")).to_have_text(re.compile(r"^\d+ new scenes: show$"))
        page.locator("#live a").click()
        expect(page.locator(".scene").first).to_be_visible()
        expect(page.locator(".chip")).to_have_text([re.compile(r"^log: car-9/\* ")])


def test_the_progress_follows_the_verdicts_of_others(browser: Browser, review: Review) -> None:
    with opened(browser, review) as page:
        named(page, "Ada", "50")
        expect(page.locator("#progress")).to_have_text("0 of 50")
        bob = review.client("Bob")
        for row in bob.scenes()[:3]:
            assert bob.post("/verdict", scene_id=row["scene_id"], verdict="supervised") == 303
        expect(page.locator("#progress")).to_have_text("0 of 50, precision 1.00 (0.44 to 1.00)")


def test_a_selection_is_made_of_the_filters(browser: Browser, review: Review) -> None:
    with opened(browser, review) as page:
        page.get_by_label("Kind").select_option(index=1)
        expect(page.locator(".chip")).to_have_count(1)
        page.get_by_role("link", name="Make a selection").click()
        expect(page.get_by_text("Scenes that pass the filters")).to_be_visible()
        form = page.locator("form[action='/selections']")
        form.get_by_label("Budget, scenes").fill("2")
        form.get_by_label("Name").fill("week <47>")
        form.get_by_role("button", name="Make").click()
        expect(page.locator("h1")).to_have_text("week <47>")
        expect(page.locator(".scene")).to_have_count(2)
        page.get_by_role("link", name="In the ranking").click()
        expect(page.locator(".scene")).to_have_count(2)
        expect(page.locator("#progress")).to_have_text("0 of 2")


def test_everything_works_without_script(browser: Browser, review: Review) -> None:
    with opened(browser, review, script=False) as page:
        named(page, "Ada")
        page.get_by_label("Kind").select_option(index=1)
        page.get_by_role("button", name="Apply").click()
        expect(page.locator(".chip")).to_have_count(1)
        expect(page.locator(".needs-script")).to_be_hidden()
        page.get_by_role("link", name="Selections").click()
        page.get_by_text("The best distinct scenes").click()
        page.locator("form[action='/selections']").get_by_label("Budget, scenes").fill("3")
        page.get_by_role("button", name="Make").click()
        expect(page.locator(".scene")).to_have_count(3)
        page.get_by_role("button", name=re.compile("Colours: auto")).click()
        expect(page.locator("html")).to_have_attribute("data-theme", "light")


def test_colours_follow_the_system_and_the_button(browser: Browser, review: Review) -> None:
    grounds = {}
    for dark in (False, True):
        with opened(browser, review, dark=dark) as page:
            grounds[dark] = page.locator("body").evaluate(
                "e => getComputedStyle(e).backgroundColor"
            )
    assert grounds[False] != grounds[True]
    with opened(browser, review, dark=False) as page:
        for theme in ("light", "dark"):
            page.get_by_role("button", name=re.compile("Colours")).click()
            expect(page.locator("html")).to_have_attribute("data-theme", theme)
        expect(page.locator("body")).to_have_css("background-color", grounds[True])
        page.goto("/dashboard")
        expect(page.locator("html")).to_have_attribute("data-theme", "dark")


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_no_page_is_wider_than_its_screen(
    browser: Browser, review: Review, size: dict[str, int]
) -> None:
    review.client("Ada").post("/selections", how="best", budget="2", name="n" * 80)
    with opened(browser, review, size=size) as page:
        for path in (*PATHS, f"/selection?name={'n' * 80}", "/no/such/page"):
            if path != "/no/such/page":
                page.goto(path)
            wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert wide <= 0, path


def test_a_link_of_another_site_keeps_the_name(browser: Browser, review: Review) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{review.url}/")
    named(page, "Ada")
    page.goto(review.url.replace("127.0.0.1", "localhost") + "/agreement")
    page.evaluate("url => { location.href = url }", f"{review.url}/dashboard")
    expect(page.locator("h1")).to_have_text("Dashboard")
    expect(page.locator("#who summary")).to_have_text("Ada")
    context.close()


def test_a_form_of_another_site_stores_nothing(browser: Browser, review: Review) -> None:
    ada = review.client("Ada")
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{review.url}/")
    named(page, "Ada")
    page.goto("about:blank")
    page.set_content(
        f'<form method="post" action="{review.url}/verdict">'
        f'<input name="scene_id" value="{ada.scenes()[0]["scene_id"]}">'
        '<input name="verdict" value="both"><button>Go</button></form>'
    )
    page.get_by_role("button").click()
    expect(page.locator("body")).to_contain_text("another site")
    assert all(not row["verdicts"]["both"] for row in ada.scenes())  # type: ignore[index]
    context.close()
