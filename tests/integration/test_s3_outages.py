"""A store that fails in mid-run: the daemon waits, nothing is parked, no record changes.

One daemon lives through all of it; each test gives it the log of another vehicle.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import obstore
import pytest

from service.status import LogStatus
from tests.integration.conftest import SHARD_S, SHARDS, Undisturbed, key_of
from tests.integration.daemons import System
from tests.integration.faulty_proxy import Fault, FaultyProxy
from tests.integration.object_store import OVERLAYS, READ, Ceph, Identity

pytestmark = [pytest.mark.integration, pytest.mark.acceptance, pytest.mark.timeout(900)]

ONE_FAILURE_PARKS = {"COUNTERPOINT_MAX_ATTEMPTS": "1", "COUNTERPOINT_LIST_INTERVAL_S": "0.5"}

FOOTER_BYTES = 64
"""At most so much more is read of a log that was listed a moment ago: whether it is whole."""


@dataclass(frozen=True, slots=True)
class Outpost:
    """Service and workers as one user of the store, behind a proxy, and their log bucket."""

    ceph: Ceph
    proxy: FaultyProxy
    system: System
    user: Identity
    logs: str
    fleet: Path

    def upload(self, vehicle: str, *, to: str = "") -> None:
        """Put the log of a vehicle into the bucket, or in the place of another's."""
        data = (self.fleet / key_of(vehicle)).read_bytes()
        self.ceph.open(self.logs).put(key_of(to or vehicle), data)

    def log(self, vehicle: str) -> LogStatus | None:
        """What the service says of a vehicle's log."""
        status = self.system.status()
        logs = status.logs if status is not None else ()
        return next((log for log in logs if log.log_id.startswith(f"{vehicle}/")), None)

    def until(self, vehicle: str, *states: str) -> LogStatus:
        """Wait until a vehicle's log is in one of these states."""
        found: list[LogStatus] = []

        def is_there() -> bool:
            log = self.log(vehicle)
            if log is not None and log.state in states:
                found.append(log)
            return bool(found)

        self.system.until(is_there, f"{vehicle} is {' or '.join(states)}")
        return found[0]

    def until_said(self, words: str) -> None:
        """Wait until both the service and a worker have said this."""
        self.system.until(lambda: words in self.system.service.said(), f"service says {words!r}")
        self.system.until(lambda: words in self.system.pool.said(), f"a worker says {words!r}")

    def records(self, vehicle: str) -> dict[str, str]:
        """Scene id to digest of a vehicle's current scenes."""
        rows = self.system.client.top()
        return {row.scene_id: row.sha256 for row in rows if row.scene_id.startswith(f"{vehicle}/")}

    def is_as_if_undisturbed(self, vehicle: str, expected: Undisturbed) -> None:
        """Wait until a vehicle's log is mined; nothing must tell that something was wrong."""
        log = self.until(vehicle, "done")
        assert log.shards == {"done": SHARDS}
        assert self.records(vehicle) == expected.records
        more = log.plan_bytes_read + log.mine_bytes_read - expected.bytes_read
        assert 0 <= more <= FOOTER_BYTES, "what came twice counts once"
        assert self.system.client.status().parked == ()


@pytest.fixture(scope="module")
def outpost(ceph: Ceph, fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Outpost]:
    logs, overlays, user = ceph.make_bucket(), ceph.make_bucket(), ceph.make_user()
    ceph.allow(logs, {user: READ})
    ceph.allow(overlays, {user: OVERLAYS})
    with FaultyProxy(ceph.endpoint) as proxy:
        system = System(
            tmp_path_factory.mktemp("outpost"),
            f"s3://{logs}",
            *("--shard-seconds", str(SHARD_S), "--supervised", "recorded"),
            *("--artifacts", f"s3://{overlays}"),
            env=ceph.environment(user, endpoint=proxy.endpoint) | ONE_FAILURE_PARKS,
        )
        try:
            system.start()
            yield Outpost(ceph, proxy, system, user, logs, fleet)
            assert system.stop() == [0, 0, 0]
        finally:
            system.end()


@pytest.fixture(autouse=True)
def _calm(outpost: Outpost) -> Iterator[None]:
    yield
    outpost.proxy.calm()


def test_a_gateway_killed_in_mid_read_and_started_again_goes_unnoticed(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    killed: list[bool] = []

    def happens() -> None:
        outpost.ceph.kill()
        outpost.ceph.start()
        killed.append(True)

    outpost.upload("car-0")
    outpost.until("car-0", "mining")
    outpost.proxy.in_next_body(key_of("car-0"), happens)
    outpost.is_as_if_undisturbed("car-0", undisturbed["car-0"])
    assert killed


def test_requests_that_go_wrong_every_now_and_then_change_nothing(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    faults: tuple[Fault, ...] = ("500", "503", "reset", "truncated", "delayed")
    outpost.proxy.let_fail(dict.fromkeys(faults, 0.08))
    outpost.upload("car-1")
    outpost.is_as_if_undisturbed("car-1", undisturbed["car-1"])
    outpost.system.until(lambda: outpost.proxy.faults.keys() >= set(faults), "a fault of each kind")


def test_a_store_that_fails_for_longer_than_anyone_retries_is_waited_for(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    outpost.upload("car-2")
    outpost.until("car-2", "mining")
    outpost.proxy.storm()
    outpost.until_said("answers with error 503")
    outpost.proxy.calm()
    outpost.is_as_if_undisturbed("car-2", undisturbed["car-2"])


def test_keys_taken_away_are_waited_for_and_work_again_without_a_restart(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    outpost.upload("car-3")
    outpost.until("car-3", "mining")
    outpost.ceph.remove_key(outpost.user)
    outpost.until_said("does not know these credentials (InvalidAccessKeyId)")
    outpost.ceph.restore_key(outpost.user)
    outpost.is_as_if_undisturbed("car-3", undisturbed["car-3"])
    said = "".join(daemon.said() for daemon in outpost.system.daemons)
    assert outpost.user.key_id not in said
    assert outpost.user.secret not in said


def test_an_object_replaced_while_it_is_read_is_never_mixed_with_its_successor(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    outpost.proxy.in_next_body(key_of("car-4"), lambda: outpost.upload("car-4"))
    outpost.upload("car-0", to="car-4")
    outpost.is_as_if_undisturbed("car-4", undisturbed["car-4"])
    assert "was replaced or deleted while it was read" in outpost.system.pool.said()


def test_an_object_deleted_while_it_is_read_is_gone_with_the_next_listing(
    outpost: Outpost,
) -> None:
    deleted: list[bool] = []

    def happens() -> None:
        obstore.delete(outpost.ceph.store(outpost.logs), key_of("car-9"))
        deleted.append(True)

    outpost.proxy.in_next_body(key_of("car-9"), happens)
    outpost.upload("car-1", to="car-9")
    outpost.system.until(lambda: bool(deleted), "a read of it")
    outpost.system.until(lambda: "car-9/2026-03-02/drive" not in known_logs(outpost), "it is gone")
    assert outpost.system.client.status().parked == ()
    assert outpost.records("car-9") == {}


def known_logs(outpost: Outpost) -> set[str]:
    """Ids of the logs that the service knows."""
    return {log.log_id for log in outpost.system.client.status().logs}
