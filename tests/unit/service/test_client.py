"""The client of subscribers: light to import, strict in what it is asked, and it can be stopped."""

import subprocess
import sys
from threading import Event

import pytest

from schemas.errors import TransientError
from service.client import watch_scenes
from tests.free_ports import free_endpoint


def test_the_client_needs_the_base_install_only() -> None:
    script = """
import sys
import service.client.client
assert not {"torch", "workers", "mcap", "sqlalchemy", "typer"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_history_and_since_together_are_refused_before_anything_is_opened() -> None:
    with pytest.raises(ValueError, match="history or since"):
        watch_scenes([free_endpoint()], history=3, since=3)


def test_a_watcher_must_be_told_a_router() -> None:
    with pytest.raises(ValueError, match="must name a router"):
        watch_scenes([])


def test_a_watcher_that_does_not_wait_says_that_there_is_no_router() -> None:
    with pytest.raises(TransientError, match="no router at"):
        next(watch_scenes([free_endpoint()], wait=False))


def test_a_watcher_that_waits_for_its_router_can_be_stopped() -> None:
    stop = Event()
    stop.set()
    assert list(watch_scenes([free_endpoint()], stop=stop)) == []
