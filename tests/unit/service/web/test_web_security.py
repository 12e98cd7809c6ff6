"""The guard of the page: headers, hosts, origins, tokens, cookies, and hostile names."""

from pathlib import Path

import pytest

from service.web.security import MAX_FORM_BYTES, POLICY
from tests.unit.service.mined_state import mined_state
from tests.unit.service.web.page import BASE, Page

PATHS = (
    "/",
    "/dashboard",
    "/selections",
    "/agreement",
    "/data/scenes",
    "/static/app.css",
    "/static/app.js",
    "/thumb.png?id=none",
    "/selection?name=none",
    "/no/such/page",
    "/?min=seven",
)


@pytest.mark.parametrize("path", PATHS)
def test_every_answer_has_the_policy(page: Page, path: str) -> None:
    headers = page.get(path).headers
    assert headers["content-security-policy"] == POLICY
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


def test_the_policy_is_exactly_the_promised_one() -> None:
    assert POLICY == (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    )


@pytest.mark.parametrize("path", ["/", "/dashboard", "/selections", "/agreement"])
def test_pages_have_nothing_inline_and_nothing_foreign(page: Page, path: str) -> None:
    text = page.get(path).text
    for forbidden in (" style=", "<style", "onclick", "onload", "javascript:", "//cdn", "https://"):
        assert forbidden not in text
    assert "<script>" not in text


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8087", "", "a b", "[::"])
def test_a_foreign_host_is_refused_with_a_sentence(page: Page, host: str) -> None:
    answer = page.get("/", headers={"host": host})
    assert answer.status_code == 421
    assert "name it in the setting review_hosts, or with --host" in answer.text
    assert answer.headers["content-security-policy"] == POLICY


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:1", "127.0.0.1:9", "[::1]:8087"])
def test_names_of_the_loopback_are_answered(page: Page, host: str) -> None:
    assert page.get("/", headers={"host": host}).status_code == 200


def test_a_configured_host_is_answered(state: Path) -> None:
    page = Page(state, hosts=("review.lan",))
    assert page.get("/", headers={"host": "review.lan:8087"}).status_code == 200
    assert page.get("/", headers={"host": "other.lan"}).status_code == 421


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "http://["},
        {"origin": BASE, "sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
def test_a_form_of_another_site_is_refused(page: Page, headers: dict[str, str]) -> None:
    answer = page.post("/reviewer", {"name": "Ada"}, headers=headers)
    assert answer.status_code == 403
    assert "another site" in answer.text


def test_a_form_of_this_site_is_taken(page: Page) -> None:
    headers = {"origin": BASE, "sec-fetch-site": "same-origin"}
    assert page.post("/reviewer", {"name": "Ada"}, headers=headers).status_code == 303


@pytest.mark.parametrize("path", ["/reviewer", "/theme", "/verdict", "/undo", "/selections"])
def test_a_form_needs_the_token_of_its_cookie(page: Page, state: Path, path: str) -> None:
    mine = page.token()
    other = Page(state)
    assert other.post(path, {"token": mine}).status_code == 403
    assert other.post(path, {"token": ""}).status_code == 403
    assert other.post(path, {"token": "é"}).status_code == 403
    bare = Page(state)
    assert bare.ask("POST", path, data={"token": mine}).status_code == 403


def test_a_cookie_of_another_state_is_refused_with_a_sentence(page: Page, state: Path) -> None:
    other = Page(state, key=b"o" * 32)
    token = other.as_reviewer("Ada").token()
    (cookie,) = list(other.cookies.jar)
    name = page.app.state.visitors.cookie_name
    answer = page.ask(
        "POST",
        "/verdict",
        data={"token": token},
        headers={"cookie": f"{name}={cookie.value}"},
    )
    assert answer.status_code == 403
    assert "another state" in answer.text


@pytest.mark.parametrize("value", ["", ".", "a.b.c.d.e", "a" * 5000, "....", "é"])
def test_a_broken_cookie_is_no_cookie(page: Page, value: str) -> None:
    name = page.app.state.visitors.cookie_name
    answer = page.ask("GET", "/", headers={b"cookie": f"{name}={value}".encode()})
    assert answer.status_code == 200
    assert name in answer.headers["set-cookie"]


def test_the_cookie_is_kept_from_scripts_and_from_other_sites(page: Page) -> None:
    cookie = page.get("/").headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie


def test_a_link_from_another_site_opens_the_page_with_its_cookie(page: Page) -> None:
    answer = page.get("/?vehicle=x", headers={"sec-fetch-site": "cross-site"})
    assert 'http-equiv="refresh"' in answer.text
    assert "set-cookie" not in answer.headers


def test_a_form_is_bounded(page: Page) -> None:
    answer = page.post("/reviewer", {"name": "a" * MAX_FORM_BYTES})
    assert answer.status_code == 413


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_other_methods_are_refused(page: Page, method: str) -> None:
    assert page.ask(method, "/").status_code == 405


@pytest.mark.parametrize(
    "path",
    [
        "/static/../app.py",
        "/static/%2e%2e/app.py",
        "/static/..%2fapp.py",
        "/static/....//app.py",
        "/static/%00",
        "/static//etc/passwd",
        "/static/",
    ],
)
def test_no_path_leaves_the_static_files(page: Page, path: str) -> None:
    answer = page.get(path)
    assert answer.status_code == 404
    assert "import" not in answer.text


@pytest.mark.parametrize(
    ("back", "to"),
    [
        ("/?vehicle=a", "/?vehicle=a"),
        ("https://evil.example/", "/"),
        ("//evil.example/", "/"),
        ("/\\evil.example/", "/"),
        ("/a\r\nset-cookie: x", "/"),
    ],
)
def test_a_form_goes_back_to_this_page_only(page: Page, back: str, to: str) -> None:
    answer = page.post("/reviewer", {"name": "Ada", "back": back})
    assert answer.headers["location"] == to


def test_names_of_logs_are_escaped_and_made_visible(tmp_path: Path) -> None:
    vehicle = "<script>alert(1)</script>\x1b[2J\u202egro\"'"
    mined_state(tmp_path / "s", vehicle=vehicle)
    page = Page(tmp_path / "s")
    for path in ("/", "/dashboard"):
        text = page.get(path).text
        assert "<script>alert" not in text
        assert "&lt;script&gt;" in text
        assert "\x1b" not in text
        assert "\u202e" not in text
        assert "\\x1b[2J\\u202e" in text


def test_a_fault_is_logged_and_named_without_its_trace(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr("service.web.dashboard._share_of", broken)
    answer = page.get("/dashboard")
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert "the log of counterpoint review" in answer.text
    assert answer.headers["content-security-policy"] == POLICY
