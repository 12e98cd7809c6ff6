import pytest

from service.assembly import wants_http
from service.settings.config import load_settings


def test_a_daemon_serves_its_pages_unless_told_not_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COUNTERPOINT_HTTP_LISTEN", raising=False)
    assert wants_http(load_settings(), once=False)
    monkeypatch.setenv("COUNTERPOINT_HTTP_LISTEN", "")
    assert not wants_http(load_settings(), once=False)


def test_a_run_once_serves_them_only_when_an_address_was_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("COUNTERPOINT_HTTP_LISTEN", raising=False)
    assert not wants_http(load_settings(), once=True)
    monkeypatch.setenv("COUNTERPOINT_HTTP_LISTEN", "127.0.0.1:9464")
    assert wants_http(load_settings(), once=True)
