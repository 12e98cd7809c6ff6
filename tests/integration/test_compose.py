"""The images are built, and compose.yaml runs, where a container engine answers."""

import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.factories import street_log
from tests.integration.composed import PARTS, Composed, missing

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(missing()), reason=f"containers: {missing()}"),
]


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Composed]:
    folder = tmp_path_factory.mktemp("composed")
    for each in (folder, *folder.parents[:2]):
        each.chmod(0o755)  # the images run as a user of their own
    with Composed(folder) as system:
        system.compose("build", "--quiet", *PARTS)
        yield system


def test_the_runbook_of_compose_leads_to_scenes_that_outlive_kills_and_new_containers(
    system: Composed,
) -> None:
    add_log(system, "car-1", seed=1)
    system.start()
    first = system.mined(1)
    assert first
    with urllib.request.urlopen(system.review_url, timeout=60) as page:  # noqa: S310
        assert "car-1" in page.read().decode()

    system.kill("worker", "service", "router")
    add_log(system, "car-2", seed=2)
    system.start()
    both = system.mined(2)
    assert first.items() < both.items()

    system.compose("down", "--timeout", "60")
    system.start()
    assert system.records() == both


def test_every_part_is_bound_to_its_user_its_own_key_and_a_root_that_it_cannot_change(
    system: Composed,
) -> None:
    system.start()
    for part in PARTS:
        shell = ("exec", "--no-TTY", part, "sh", "-c")
        keys = system.compose(*shell, "find /var/lib/counterpoint -name '*.key'").split()
        assert [Path(key).name for key in keys] == [f"{part}.key"]
        assert system.compose(*shell, "id --user").strip() == "10001"
        with pytest.raises(AssertionError, match="Read-only file system"):
            system.compose(*shell, "touch /opt/counterpoint/changed")


def add_log(system: Composed, vehicle: str, *, seed: int) -> None:
    """Put a small log of a vehicle into the bucket, as one that every user can read."""
    log = system.logs / vehicle / "drive.mcap"
    log.parent.mkdir()
    street_log(log, frames=20, seed=seed, vehicle=vehicle)
    log.parent.chmod(0o755)
    log.chmod(0o644)
