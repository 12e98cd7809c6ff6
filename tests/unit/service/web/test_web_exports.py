"""Exports from the page of a selection: started, watched, stopped, and by the same command."""

import json
import re
import threading
import time
from pathlib import Path

import pytest

from service.api.overlay_cache import OpenOverlays
from service.cli.review import exports_of
from service.export.jobs import ExportJobs, JobState
from service.http.app import make_api
from service.settings.config import load_settings
from service.web.app import make_app
from service.web.settings import WebSettings
from service.web.source import source_of_state
from tests.unit.service.web.page import Page

_START_S = 200.0
"""For a process that starts on a busy machine."""


def page_with_exports(page: Page, state: Path) -> tuple[Page, ExportJobs]:
    """Give a page the exports that `counterpoint review` gives it."""
    settings = load_settings(state=state)
    jobs = exports_of(settings, is_state=True)
    assert jobs is not None
    page.app = make_app(source_of_state(settings), WebSettings(str(state), b"k" * 32), jobs)
    page.post("/selections", {"how": "best", "budget": "2", "name": "week <47>"})
    return page, jobs


def test_a_selection_is_exported_by_the_command_in_the_background(page: Page, state: Path) -> None:
    page, jobs = page_with_exports(page, state)
    text = page.get("/selection?name=week+%3C47%3E").text
    assert '<option value="openlabel">' in text
    assert re.search(r'<option value="semantickitti" disabled title="reads the logs', text)
    answer = page.post("/exports", {"selection": "week <47>", "form": "openlabel"})
    assert answer.status_code == 303, answer.text
    assert answer.headers["location"] == "/selection?name=week%20%3C47%3E#exports"
    end_s = time.monotonic() + _START_S
    while jobs.jobs()[0].is_open:
        assert time.monotonic() < end_s, jobs.jobs()
        threading.Event().wait(0.05)
    (job,) = page.ask("GET", "/data/exports", params={"selection": "week <47>"}).json()["jobs"]
    assert (job["state"], job["done"], job["scenes"]) == ("done", 2, 2), job
    assert job["text"].endswith("2 scenes written as openlabel")
    assert str(state / "exports") in job["command"]
    written = [path for path in Path(job["out"]).rglob("*.json") if path.is_file()]
    assert len(written) == 2
    assert "openlabel" in json.loads(written[0].read_text())
    text = page.get("/selection?name=week+%3C47%3E").text
    assert 'data-state="done"' in text
    assert "--format openlabel" in text
    jobs.close()


def test_an_export_that_cannot_be_is_refused_with_a_sentence(page: Page, state: Path) -> None:
    page, jobs = page_with_exports(page, state)
    for fields, words in (
        ({"selection": "week <47>", "form": "csv"}, "no format 'csv'"),
        ({"selection": "week <47>", "form": "cvat"}, "reads the logs"),
        ({"selection": "none", "form": "json"}, "no selection 'none'"),
    ):
        answer = page.post_json("/exports", fields)
        assert answer.status_code in (400, 404)
        assert words in answer.json()["problem"]
    assert page.post("/exports", {"token": "", "selection": "week <47>"}).status_code == 403
    assert page.post_json("/exports/stop", {"number": "7"}).status_code == 404
    assert page.post_json("/exports/stop", {"number": "-1"}).status_code == 400
    assert jobs.jobs() == []


def test_without_a_folder_the_page_shows_the_command(page: Page) -> None:
    page.post("/selections", {"how": "best", "budget": "2", "name": "week"})
    text = page.get("/selection?name=week").text
    assert "counterpoint export week --format FORMAT --out DIR" in text
    answer = page.post_json("/exports", {"selection": "week", "form": "json"})
    assert answer.status_code == 400
    assert "--exports" in answer.json()["problem"]
    assert page.get("/data/exports").json() == {"jobs": []}


@pytest.mark.parametrize(
    ("is_state", "exports", "place"),
    [
        (True, "", "s/exports/week-json"),
        (True, "gs://b/x/", "gs://b/x/week-json"),
        (False, "", None),
        (False, "out", "out/week-json"),
    ],
)
def test_the_folder_is_in_the_state_or_the_one_that_was_named(
    is_state: bool, exports: str, place: str | None
) -> None:
    settings = load_settings(state=Path("s"), connect="tcp/a:1", review_exports=exports)
    jobs = exports_of(settings, is_state=is_state, config=Path("c.toml"))
    if place is None:
        assert jobs is None
        return
    assert jobs is not None
    assert jobs.place("week", "json") == place
    source = "--state s" if is_state else "--connect tcp/a:1"
    assert f"--config c.toml {source}" in jobs.command("week", "json")
    assert JobState.WAITING not in [job.state for job in jobs.jobs()]


def test_the_api_starts_lists_and_stops_exports_as_the_page_does(page: Page, state: Path) -> None:
    page, jobs = page_with_exports(page, state)
    assert page.get("/api/v1/exports").json() == {"exports": []}
    wanted = {"selection": "week <47>", "format": "openlabel"}
    answer = page.ask("POST", "/api/v1/exports", json=wanted)
    assert answer.status_code == 202, answer.text
    assert answer.json()["scenes"] == 2
    end_s = time.monotonic() + _START_S
    while jobs.jobs()[0].is_open:
        assert time.monotonic() < end_s, jobs.jobs()
        threading.Event().wait(0.05)
    (row,) = page.get("/api/v1/exports?selection=week+%3C47%3E").json()["exports"]
    assert (row["number"], row["state"], row["done"]) == (1, "done", 2), row
    assert len(list(Path(row["out"]).rglob("*.json"))) >= 2
    assert page.get("/api/v1/exports?selection=other").json() == {"exports": []}
    stopped = page.ask("POST", "/api/v1/exports/1/stop", json={})
    assert stopped.json()["state"] == "done"
    for path, body, status, words in (
        ("", wanted | {"format": "csv"}, 400, "no format 'csv'"),
        ("", wanted | {"format": "cvat"}, 400, "reads the logs"),
        ("", wanted | {"selection": "none"}, 404, "no selection 'none'"),
        ("/7/stop", {}, 404, "no export of the number 7"),
    ):
        refused = page.ask("POST", f"/api/v1/exports{path}", json=body)
        assert (refused.status_code, words in refused.json()["detail"]) == (status, True)
    jobs.close()


def test_who_may_only_read_lists_exports_and_starts_none(state: Path) -> None:
    source = source_of_state(load_settings(state=state))
    page = Page(state)
    page.app = make_api(source, OpenOverlays(), admit=lambda request, access: access == "read")
    assert page.get("/exports").json() == {"exports": []}
    for path in ("/exports", "/exports/1/stop"):
        body = {"selection": "week", "format": "json"}
        assert page.ask("POST", path, json=body).status_code == 403
