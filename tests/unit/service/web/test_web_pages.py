"""The pages of a state: list, filters, cursor, verdicts, selections, agreement, dashboard."""

import io
import json
import re
import shutil
from pathlib import Path

import pytest
from PIL import Image

from service.pictures.thumbnail import HEIGHT_PX, WIDTH_PX
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.contracts.test_listing_contract import commit, scene
from tests.factories import track_at
from tests.unit.service.mined_state import scenes_at
from tests.unit.service.web.page import Page


def test_the_list_has_a_card_for_each_scene_best_first(page: Page) -> None:
    text, rows = page.get("/").text, page.scenes()
    assert rows
    assert text.count('class="headline"') == len(rows)
    assert [row["score"] for row in rows] == sorted((row["score"] for row in rows), reverse=True)
    for row in rows:
        assert row["sha256"] in text
    assert f"<h1>{len(rows)} scenes</h1>" in text


def test_pages_of_the_list_have_each_scene_once(page: Page) -> None:
    every = [row["scene_id"] for row in page.scenes()]
    seen: list[str] = []
    query = "?most=3"
    for _ in every:
        answer = page.get(f"/data/scenes{query}").json()
        seen += [row["scene_id"] for row in answer["rows"]]
        if not answer["next"]:
            break
        query = f"?most=3&after={answer['next']}"
    assert seen == every


def test_filters_are_kept_in_the_form_and_can_be_removed(page: Page) -> None:
    text = page.get("/?vehicle=nobody&min=0.2&judged=no").text
    assert "vehicle: nobody" in text
    assert "No current scene passes these filters" in text
    assert 'value="0.2"' in text
    assert 'href="/?min=0.2&amp;judged=no"' in text, "each chip removes its own filter"


@pytest.mark.parametrize(
    "query",
    [
        "min=seven",
        "max=2",
        "within=-1",
        "within=nan",
        "within=30.5",
        "beyond=1e400",
        "beyond=" + "9" * 4000,
        "beyond=50&within=30",
        "kind=%00",
        "wrong=everybody",
        "since=yesterday",
        "since=2026-01-02&until=2026-01-01",
        "sort=luck",
        "after=nonsense",
        "judged=mine",
        "most=1e9",
        "most=-1",
        "q=" + "a" * 5000,
        "vehicle=" + "%F0%9F%9A%97" * 2000,
        "since=99999-01-01",
    ],
)
def test_an_absurd_filter_is_named_and_the_list_is_shown(page: Page, query: str) -> None:
    answer = page.get(f"/?{query}")
    assert answer.status_code in (200, 400)
    if answer.status_code == 400 and "most" not in query:
        assert 'role="alert"' in answer.text or "problem" in answer.text
    assert page.get(f"/data/scenes?{query}").status_code in (200, 400)


def test_scenes_are_filtered_by_range(page: Page, state: Path) -> None:
    scenes_at(state, 12.4, 30.0, 45.0, 90.0)
    assert [row["tracks"][0]["range_m"] for row in page.scenes("?within=30")] == [12.4, 30.0]
    assert [row["tracks"][0]["range_m"] for row in page.scenes("?beyond=30")] == [45.0, 90.0]
    text = page.get("/?beyond=20&within=50&q=at").text
    assert "<h1>2 scenes</h1>" in text
    assert re.findall(r'name="(beyond|within)" value="(\d+)"', text) == [
        ("beyond", "20"),
        ("within", "50"),
    ]
    assert '<a class="chip" href="/?within=50&amp;q=at" title="Remove this filter">' in text
    assert "range beyond: 20 m" in text
    assert "range within: 50 m" in text
    made = page.post("/selections", {"how": "filters", "budget": "9", "name": "n", "within": "20"})
    assert "1 of at most 9 scenes" in page.get(made.headers["location"]).text


def test_a_card_names_the_track_that_passes_where_it_is_not_the_first(
    page: Page, state: Path
) -> None:
    tracks = [track_at(10.0 * n, track_id=n, class_name=f"c{n}") for n in range(1, 8)]
    store = open_store(state)
    commit(World.on(store), scene(0, log_id="car-9/b", tracks=tuple(tracks)))
    store.close()
    named = re.compile(r'title="The strongest track that passes the filters">([^<]*)<')
    assert named.findall(page.get("/").text) == []
    assert named.findall(page.get("/?within=10").text) == []
    assert named.findall(page.get("/?beyond=10&class=c3").text) == ["track 4: c3, 30 m"]
    assert named.findall(page.get("/?beyond=10&class=C3").text) == ["track 4: c3, 30 m"]
    assert "&amp;class=c3&amp;beyond=10&amp;track=3" in page.get("/?beyond=10&class=c3").text
    assert named.findall(page.get("/?beyond=60").text) == ["a weaker track passes"]


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ("within=-1", "range within: Input should be greater than or equal to 1"),
        ("within=nan", "range within: Input should be a valid integer"),
        ("within=200", "range within: Input should be less than or equal to 125"),
        ("beyond=far", "range beyond: Input should be a valid integer"),
        ("beyond=50&within=30", "range within: Input should be greater than beyond, which is 50 m"),
    ],
)
def test_a_range_that_is_not_possible_is_named(page: Page, query: str, problem: str) -> None:
    answer = page.get(f"/?{query}")
    assert answer.status_code == 400
    assert f"this filter is not possible: {problem}" in answer.text


def test_a_thumbnail_is_drawn_once_and_kept(page: Page) -> None:
    row = page.scenes()[0]
    address = f"/thumb.png?id={row['scene_id']}&digest={row['sha256']}"
    answer = page.get(address)
    assert Image.open(io.BytesIO(answer.content)).size == (WIDTH_PX, HEIGHT_PX)
    assert "immutable" in answer.headers["cache-control"]
    assert page.get(address).content == answer.content


@pytest.mark.parametrize("scene_id", ["", "none", "../../etc/passwd", "a" * 5000, "\x1b[2J"])
def test_a_thumbnail_of_no_scene_is_a_picture_that_says_so(page: Page, scene_id: str) -> None:
    answer = page.ask("GET", "/thumb.png", params={"id": scene_id})
    assert answer.status_code == 200
    assert answer.headers["cache-control"] == "no-store"
    assert Image.open(io.BytesIO(answer.content)).size == (WIDTH_PX, HEIGHT_PX)


def test_a_state_whose_overlays_are_gone_is_still_reviewed(page: Page, state: Path) -> None:
    shutil.rmtree(state / "artifacts")
    row = page.scenes()[0]
    assert page.get("/").status_code == 200
    answer = page.get(f"/thumb.png?id={row['scene_id']}&digest={row['sha256']}")
    assert answer.status_code == 200
    assert answer.headers["cache-control"] == "no-store", "it may come back"


@pytest.mark.parametrize("payload", [b"", b"CPOVL2\n\0" + b"\xff" * 64, b"\x28\xb5\x2f\xfd" * 9])
def test_a_broken_overlay_has_a_picture_that_says_so(
    page: Page, state: Path, payload: bytes
) -> None:
    for file in (state / "artifacts").rglob("*"):
        if file.is_file():
            file.write_bytes(payload)
    row = page.scenes()[0]
    answer = page.get(f"/thumb.png?id={row['scene_id']}&digest={row['sha256']}")
    assert answer.status_code == 200
    assert answer.headers["cache-control"] == "no-store"


def test_a_verdict_is_stored_once_and_undone(page: Page) -> None:
    page.as_reviewer("Ada", budget=5)
    row = page.scenes()[0]
    fields = {
        "scene_id": row["scene_id"],
        "sha256": row["sha256"],
        "verdict": "supervised",
        "cause": "unseen_class",
        "note": "a <b>note</b>",
        "took_s": "7.4",
        "key": "tab-1",
    }
    first, again = (page.post_json("/verdict", fields).json() for _ in range(2))
    assert first["stored"]["ordinal"] == again["stored"]["ordinal"]
    assert first["progress"]["text"].startswith("1 of 5, 7 s a scene, precision 1.00 (")
    assert page.scenes()[0]["verdicts"]["mine"] == "supervised"
    assert "✓ supervised wrong" in page.get("/").text
    assert "a &lt;b&gt;note&lt;/b&gt;" in page.get("/agreement").text
    undone = page.post_json("/undo", {"scene_id": row["scene_id"]}).json()
    assert undone["stored"]["verdict"] == "withdrawn"
    assert page.scenes()[0]["verdicts"]["mine"] is None


def test_a_form_without_script_goes_back_to_its_page(page: Page) -> None:
    row = page.scenes()[0]
    fields = {
        "scene_id": row["scene_id"],
        "sha256": row["sha256"],
        "verdict": "neither",
        "reviewer": "Bob",
        "back": "/?sort=newest",
    }
    answer = page.post("/verdict", fields)
    assert (answer.status_code, answer.headers["location"]) == (303, "/?sort=newest")
    assert 'data-reviewer="Bob"' in page.get("/").text, "the name is kept"


@pytest.mark.parametrize(
    ("fields", "status", "words"),
    [
        ({}, 400, "scene_id"),
        ({"scene_id": "none", "verdict": "supervised"}, 404, "none"),
        ({"verdict": "guilty"}, 400, "verdict"),
        ({"verdict": "withdrawn"}, 400, ""),
        ({"verdict": "both", "cause": "gremlins"}, 400, "gremlins"),
        ({"verdict": "both", "track_id": "-1"}, 400, "track_id"),
        ({"verdict": "both", "took_s": "nan"}, 400, "took_s"),
        ({"verdict": "both", "note": "n" * 3000}, 400, "note"),
    ],
)
def test_an_impossible_verdict_is_refused_with_a_sentence(
    page: Page, fields: dict[str, str], status: int, words: str
) -> None:
    page.as_reviewer("Ada")
    scene_id = page.scenes()[0]["scene_id"] if fields else ""
    answer = page.post_json("/verdict", {"scene_id": scene_id} | fields)
    assert answer.status_code == status, answer.text
    assert words in answer.json()["problem"]


def test_a_verdict_needs_a_name(page: Page) -> None:
    row = page.scenes()[0]
    fields = {"scene_id": row["scene_id"], "verdict": "both"}
    answer = page.post_json("/verdict", fields)
    assert answer.status_code == 400
    assert "your" in answer.json()["problem"]


@pytest.mark.parametrize("name", [" ", "a" * 257, "a\x1b[2J", "\u202e"])
def test_a_name_has_printing_characters(page: Page, name: str) -> None:
    assert page.post("/reviewer", {"name": name}).status_code == 400


@pytest.mark.parametrize("budget", ["-1", "1e3", "99999999", "٣", "x"])
def test_a_budget_is_a_number(page: Page, budget: str) -> None:
    assert page.post("/reviewer", {"name": "Ada", "budget": budget}).status_code == 400


def test_two_reviewers_agree_or_conflict(page: Page, state: Path) -> None:
    other = Page(state).as_reviewer("Bob")
    page.as_reviewer("Ada")
    for i, row in enumerate(page.scenes()[:4]):
        for who, verdict in ((page, "supervised"), (other, "neither" if i == 0 else "supervised")):
            fields = {"scene_id": row["scene_id"], "sha256": row["sha256"], "verdict": verdict}
            assert who.post_json("/verdict", fields).status_code == 200
    text = page.get("/agreement").text
    assert "Ada and Bob" in text
    assert "Ada: supervised wrong" in text
    assert "Bob: neither wrong" in text
    assert re.search(r'<dt>Conflicts</dt><dd><a href="#conflicts">1</a>', text)


def test_a_selection_of_the_filters_is_made_shown_and_written_as_json(page: Page) -> None:
    rows = page.scenes("?sort=score")
    made = page.post("/selections", {"how": "filters", "budget": "3", "name": "my <i>three</i>"})
    assert made.status_code == 303, made.text
    text = page.get(made.headers["location"]).text
    assert "my &lt;i&gt;three&lt;/i&gt;" in text
    assert "3 of at most 3 scenes" in text
    lines = page.ask("GET", "/data/selection", params={"name": "my <i>three</i>"}).text.splitlines()
    assert {json.loads(line)["scene_id"] for line in lines} == {row["scene_id"] for row in rows[:3]}
    assert "chosen by hand" in page.get("/selections").text
    assert len(page.scenes("?selection=my+<i>three</i>")) == 3


def test_a_selection_by_budget_takes_the_best_distinct_scenes(page: Page) -> None:
    made = page.post_json("/selections", {"how": "best", "budget": "2", "name": ""}).json()
    assert (made["name"], made["strategy"], len(made["scenes"])) == (
        "selection-1",
        "best-distinct",
        2,
    )
    again = page.post_json("/selections", {"how": "best", "budget": "1", "name": "selection-1"})
    assert again.status_code == 400
    assert "exists" in again.json()["problem"]


@pytest.mark.parametrize(
    "fields",
    [
        {"how": "best", "budget": "0"},
        {"how": "best", "budget": "many"},
        {"how": "luck", "budget": "3"},
        {"how": "filters", "budget": "3", "vehicle": "none"},
        {"how": "best", "budget": "3", "name": "n" * 300},
    ],
)
def test_an_impossible_selection_is_refused(page: Page, fields: dict[str, str]) -> None:
    assert page.post_json("/selections", fields).status_code == 400


def test_the_dashboard_links_each_point_to_its_scenes(page: Page) -> None:
    text = page.get("/dashboard?per=hour").text
    (address,) = set(re.findall(r'<a href="(/\?since=[^"]+)"', text))
    count = page.get("/data/scenes" + address[1:].replace("&amp;", "&")).json()["total"]
    assert count == len(page.scenes())
    assert 'href="/?vehicle=' in text


@pytest.mark.parametrize("query", ["per=week", "since=x", "per=<script>"])
def test_an_absurd_dashboard_is_refused(page: Page, query: str) -> None:
    answer = page.get(f"/dashboard?{query}")
    assert answer.status_code == 400
    assert "<script>" not in answer.text.replace("<script type", "")


def test_an_empty_state_has_pages(tmp_path: Path) -> None:
    from service.store.engine import open_store

    (tmp_path / "s").mkdir()
    open_store(tmp_path / "s").close()
    page = Page(tmp_path / "s")
    for path in ("/", "/dashboard", "/selections", "/agreement"):
        assert page.get(path).status_code == 200
    assert "No scene yet" in page.get("/").text


def test_a_state_that_is_gone_is_named(page: Page, state: Path) -> None:
    shutil.rmtree(state)
    answer = page.get("/")
    assert answer.status_code in (400, 404, 503)
    assert str(state) in answer.text
