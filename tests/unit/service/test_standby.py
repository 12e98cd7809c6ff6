"""A standby measures the silence of the active service by its own clock, and by beats alone."""

from pathlib import Path

import pytest

from schemas.runtime.http_endpoint import HttpRequest
from service.alone import need_shared_places
from service.background.standby import Silence
from service.errors import UsageError
from service.monitoring.http_pages import standby_pages
from service.settings.config import load_settings
from service.store.service_lease import LeaseSeen


class Monotonic:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


def silence_after(*looks: tuple[float, int | None], lease_s: float = 5.0) -> list[bool]:
    """Look at beats at these times; return each verdict."""
    clock = Monotonic()
    silence = Silence(default_s=5.0, clock=clock)
    found = []
    for at_s, beats in looks:
        clock.s = at_s
        found.append(silence.is_over(LeaseSeen(7, beats, lease_s)))
    return found


def steadily(until_s: float, beats: int | None) -> list[tuple[float, int | None]]:
    return [(0.5 * number, beats) for number in range(1, int(2 * until_s) + 1)]


def test_a_holder_that_beats_is_never_silent() -> None:
    assert not any(silence_after(*((0.5 * n, n // 2) for n in range(1, 60))))


def test_a_holder_without_beats_is_silent_after_its_lease() -> None:
    found = silence_after(*steadily(8.0, 3))
    assert found.index(True) == 11, "first look at 0.5 s, over after more than 5 s"


def test_a_lease_that_its_holder_states_is_kept() -> None:
    assert not any(silence_after(*steadily(8.0, 3), lease_s=60.0))


def test_a_holder_that_has_not_beaten_yet_gets_the_default() -> None:
    assert any(silence_after(*steadily(8.0, 0), lease_s=0.0))


def test_a_database_without_a_lease_is_left_to_its_lock() -> None:
    assert not any(silence_after(*steadily(60.0, None)))


def test_a_standby_that_was_frozen_itself_measures_again_from_its_waking() -> None:
    assert silence_after((0.5, 3), (100.0, 3), (100.5, 3)) == [False, False, False]


@pytest.mark.parametrize("database", ["", "postgresql://app@host/db"])
def test_a_standby_needs_places_that_both_see(database: str, tmp_path: Path) -> None:
    settings = load_settings(standby=True, state=tmp_path, database=database)
    with pytest.raises(UsageError, match="--database postgresql://user@host/name and --artifacts"):
        need_shared_places(settings)


class Sees:
    """A standby with a problem, or without."""

    def __init__(self, problem: str) -> None:
        self.problem = problem


@pytest.mark.parametrize(("problem", "status"), [("", 200), ("the server is away", 503)])
def test_a_standby_names_its_role_and_is_ready_if_it_sees_the_database(
    problem: str, status: int
) -> None:
    pages = standby_pages(Sees(problem))
    answer = pages["/readyz"](HttpRequest())
    assert answer.status == status
    assert b'"role": "standby"' in answer.body.replace(b'":"', b'": "')
    assert b"counterpoint_service_active 0.0" in pages["/metrics"](HttpRequest()).body
