"""`counterpoint review`: what it needs, where it listens, and what it does with old states."""

import re
import shutil
import threading
from pathlib import Path
from typing import Any

import httpx
import pytest

from schemas.errors import TransientError
from schemas.runtime.http_address import is_loopback_host
from service.cli import review
from service.cli.main import main
from service.errors import StateInUseError, StateOutdatedError, UsageError
from service.settings.config import Settings, load_settings
from service.store.state import StateLock
from service.web.server import address_of, listening
from service.web.settings import key_of_state


def settings_of(state: Path, **changes: Any) -> Settings:
    return load_settings(state=state, **({"review_listen": "127.0.0.1:0"} | changes))


def test_without_the_extra_the_command_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(review, "find_spec", lambda name: None if name == "fastapi" else object())
    assert main(["review", "--state", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert "pip install 'counterpoint[review]' (missing: fastapi)" in said


@pytest.mark.parametrize("flags", [["--state", "none"], ["--state", "a", "--connect", "tcp/b:1"]])
def test_a_source_that_is_none_is_refused(
    flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["review", *flags]) == 1
    assert "error: " in capsys.readouterr().err


@pytest.mark.parametrize(
    "listen", ["", "8087", "127.0.0.1", ":8087", "127.0.0.1:", "a:99999", "a:-1", "a:٣"]
)
def test_an_address_is_a_host_and_a_port(listen: str) -> None:
    with pytest.raises(UsageError, match="HOST:PORT"):
        address_of(listen)


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("::1", True),
        ("localhost", True),
        ("127.1.2.3", True),
        ("0.0.0.0", False),  # noqa: S104
        ("10.0.0.7", False),
        ("review.lan", False),
    ],
)
def test_the_loopback_is_known(host: str, own: bool) -> None:
    assert is_loopback_host(host) is own


def test_every_address_needs_the_names_of_hosts(state: Path) -> None:
    everywhere = settings_of(state, review_listen="0.0.0.0:0", insecure=True)
    with (
        pytest.raises(UsageError, match="set review_hosts, or give --host"),
        review.page_of(everywhere, is_state=True),
    ):
        pytest.fail("it was served")


def test_other_machines_are_warned_of(state: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = {"review_listen": "0.0.0.0:0", "review_hosts": ["review.lan"]}
    with (
        pytest.raises(UsageError, match=r"lacks TLS .* and credentials"),
        review.page_of(settings_of(state, **at), is_state=True),
    ):
        pytest.fail("it was served")
    settings = settings_of(state, **at, insecure=True)
    with review.page_of(settings, is_state=True):
        said = capsys.readouterr().err
    assert "other machines reach the page as review.lan: it has no password" in said


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("0.0.0.0", "127.0.0.1"), ("[::]", "[::1]")],  # noqa: S104
)
def test_a_page_on_every_address_says_so(
    state: Path, capsys: pytest.CaptureFixture[str], host: str, loopback: str
) -> None:
    at = {"review_listen": f"{host}:0", "review_hosts": ["review.lan"], "insecure": True}
    with review.page_of(settings_of(state, **at), is_state=True):
        said = " ".join(capsys.readouterr().err.split())
    found = re.search(r"review page: http://(\S+)/ \(listens on every address, (\S+)\)", said)
    assert found
    port = found[1].removeprefix(f"{loopback}:")
    assert found[2] == f"{host}:{port}"


def test_a_taken_address_is_named() -> None:
    with listening("127.0.0.1:0") as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(TransientError, match=f"review page on {address}.*--listen"):
            listening(address)


def test_the_page_answers_at_its_printed_address(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with review.page_of(settings_of(state), is_state=True) as thread:
        said = capsys.readouterr().err
        url = said.partition("review page: ")[2].strip()
        assert httpx.get(url).status_code == 200
        with httpx.stream("GET", f"{url}live") as events:
            assert next(events.iter_lines()).startswith("retry:")
    thread.join(10)
    assert not thread.is_alive(), "an open stream of events keeps no page"


def test_a_state_of_an_earlier_version_is_brought_up_to_date(
    state: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    review.bring_up_to_date(settings_of(state))
    assert "brought up to date" not in capsys.readouterr().err, "it is of this version"

    def outdated(_: Settings) -> None:
        raise StateOutdatedError("state has an older schema version")

    monkeypatch.setattr("service.store.opening.open_ledger_store_to_read", outdated)
    review.bring_up_to_date(settings_of(state))
    assert f"brought up to date: {state}" in capsys.readouterr().err
    with StateLock(state), pytest.raises(StateInUseError):
        review.bring_up_to_date(settings_of(state))


def test_a_key_belongs_to_one_state(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    key = key_of_state(one, place="a")
    assert key_of_state(one, place="b") == key, "the same after a restart"
    assert key_of_state(other, place="a") != key
    assert (one / "review.key").stat().st_mode & 0o077 == 0


def test_a_source_without_a_folder_has_a_key_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    key = key_of_state(None, place="tcp/a:1")
    assert key_of_state(None, place="tcp/a:1") == key
    assert key_of_state(None, place="tcp/b:1") != key
    next(tmp_path.glob("review-*.key")).write_bytes(b"cut")
    keys = {key_of_state(None, place=place) for place in ("tcp/a:1", "tcp/b:1")}
    assert len(keys) == 2


def test_two_that_start_at_once_have_one_key(tmp_path: Path) -> None:
    keys: list[bytes] = []
    threads = [
        threading.Thread(target=lambda: keys.append(key_of_state(tmp_path, place="a")))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(keys)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["review.key"]


def test_a_state_folder_that_cannot_be_written_is_reviewed(
    state: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    shutil.rmtree(tmp_path / "cache", ignore_errors=True)

    def refused(_path: Path) -> bytes:
        raise OSError(30, "read-only file system")

    monkeypatch.setattr("service.web.settings._key_in", refused)
    assert len(key_of_state(state, place="a")) == 32
