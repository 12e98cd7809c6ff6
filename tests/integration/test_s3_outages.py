"""A store that fails in mid-run: the daemon waits, nothing is parked, no record changes.

One daemon lives through all of it; each test gives it the log of another vehicle.
"""

import re
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import obstore
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.curation.status import LogStatus
from tests.factories import street_log
from tests.integration.conftest import SECONDS, SHARD_S, SHARDS, Undisturbed, key_of
from tests.integration.credential_server import CredentialServer
from tests.integration.daemons import Daemon, System
from tests.integration.faulty_proxy import Fault, FaultyProxy
from tests.integration.object_store import OVERLAYS, READ, Ceph

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

ONE_FAILURE_PARKS = {"COUNTERPOINT_MAX_ATTEMPTS": "1", "COUNTERPOINT_LIST_INTERVAL_S": "0.5"}
PAGES = {
    "COUNTERPOINT_HTTP_LISTEN": "127.0.0.1:0",
    "COUNTERPOINT_WORKER_HTTP_LISTEN": "127.0.0.1:0",
}

FOOTER_BYTES = 64
"""At most so much more is read of a log that was listed a moment ago: whether it is whole."""


@dataclass(slots=True)
class Outpost:
    """Service and workers as one user of the store, behind a proxy, and their log bucket."""

    ceph: Ceph
    proxy: FaultyProxy
    credentials: CredentialServer
    system: System
    logs: str
    fleet: Path
    heard: dict[str, int] = field(default_factory=dict)
    """Name of a daemon to how much of what it said belongs to the tests before."""

    def begin(self) -> None:
        """Forget what was said so far."""
        for daemon in self.system.daemons:
            self.heard[daemon.name] = len(daemon.said())

    def said(self, daemon: Daemon) -> str:
        """What a daemon has said in this test."""
        return daemon.said()[self.heard[daemon.name] :]

    def upload(self, vehicle: str) -> None:
        """Put the log of a vehicle into the bucket."""
        self._put(vehicle, self.fleet / key_of(vehicle))

    def upload_another(self, vehicle: str, folder: Path) -> None:
        """Put a log that is like no other in the place of a vehicle's."""
        log = folder / "another.mcap"
        street_log(log, frames=10 * SECONDS, seed=90, style="stands", vehicle=vehicle)
        self._put(vehicle, log)

    def _put(self, vehicle: str, log: Path) -> None:
        self.ceph.open(self.logs).put(key_of(vehicle), log.read_bytes())

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

    def until_said(self, daemon: Daemon, words: str) -> None:
        """Wait until a daemon has said this."""
        self.system.until(lambda: words in self.said(daemon), f"{daemon.name} says {words!r}")

    def counted(self, daemon: Daemon, name: str, **labels: str) -> float:
        """Sum of the samples of a daemon's page that have these labels."""
        (url,) = re.findall(r"metrics at (http://\S+/metrics)", daemon.said())
        with urllib.request.urlopen(url, timeout=60) as answer:  # noqa: S310
            page = answer.read().decode()
        found = [
            sample.value
            for family in text_string_to_metric_families(page)
            for sample in family.samples
            if sample.name == f"counterpoint_{name}" and labels.items() <= sample.labels.items()
        ]
        assert found, f"no {name} {labels} in\n{page}"
        return sum(found)

    def until_more(self, daemon: Daemon, name: str, than: float, **labels: str) -> None:
        """Wait until a daemon's page says more than this."""
        self.system.until(
            lambda: self.counted(daemon, name, **labels) > than, f"{name} above {than}"
        )

    def trouble_is_said_counted_and_over(
        self, words: str, kind: str, *, begins: Callable[[], None], ends: Callable[[], None]
    ) -> None:
        """Begin trouble, wait until service and workers wait, end it, and see them go on.

        A busy machine makes small trouble of its own, so what was counted and said before counts
        for nothing.
        """
        service, pool = self.system.service, self.system.pool
        leases = self.counted(pool, "worker_store_errors_total", kind=kind)
        begins()
        listings = self.counted(service, "bucket_errors_total", kind=kind)
        self.until_more(service, "bucket_errors_total", listings, kind=kind)
        self.until_more(pool, "worker_store_errors_total", leases, kind=kind)
        self.until_more(pool, "worker_waiting_for_store", 0)
        for daemon in (service, pool):
            self.until_said(daemon, words)
        listed_s = self.counted(service, "bucket_last_listing_timestamp_seconds")
        self.begin()
        ends()
        self.until_said(service, "works again what='listing of the bucket'")
        self.until_said(pool, "store works again")
        self.until_more(service, "bucket_last_listing_timestamp_seconds", listed_s)
        self.system.until(
            lambda: self.counted(pool, "worker_waiting_for_store") == 0, "no worker that waits"
        )

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
    folder = tmp_path_factory.mktemp("outpost")
    environment = ceph.environment(user)
    del environment["AWS_ACCESS_KEY_ID"], environment["AWS_SECRET_ACCESS_KEY"]
    with FaultyProxy(ceph.endpoint) as proxy, CredentialServer(user, folder) as credentials:
        environment |= credentials.environment | {"AWS_ENDPOINT_URL": proxy.endpoint}
        system = System(
            folder,
            f"s3://{logs}",
            *("--shard-seconds", str(SHARD_S), "--supervised", "recorded"),
            *("--artifacts", f"s3://{overlays}"),
            env=environment | PAGES | ONE_FAILURE_PARKS,
        )
        try:
            system.start()
            outpost = Outpost(ceph, proxy, credentials, system, logs, fleet)
            outpost.begin()
            for daemon in (system.service, system.pool):
                outpost.until_said(daemon, "metrics at http://")
            yield outpost
            assert system.stop() == [0, 0, 0]
        finally:
            system.end()


@pytest.fixture(autouse=True)
def _calm(outpost: Outpost) -> Iterator[None]:
    outpost.begin()
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
    outpost.trouble_is_said_counted_and_over(
        "answers with error 503",
        "unreachable",
        begins=outpost.proxy.storm,
        ends=outpost.proxy.calm,
    )
    outpost.is_as_if_undisturbed("car-2", undisturbed["car-2"])


def test_a_gateway_that_is_gone_for_longer_than_anyone_retries_is_waited_for(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    outpost.upload("car-5")
    outpost.until("car-5", "mining")
    try:
        outpost.trouble_is_said_counted_and_over(
            "the store cannot be reached",
            "unreachable",
            begins=outpost.ceph.kill,
            ends=outpost.ceph.start,
        )
    finally:
        outpost.ceph.start()
    outpost.is_as_if_undisturbed("car-5", undisturbed["car-5"])


def test_keys_that_expire_are_waited_for_and_new_ones_work_without_a_restart(
    outpost: Outpost, undisturbed: dict[str, Undisturbed]
) -> None:
    expired = outpost.credentials.user
    outpost.upload("car-3")
    outpost.until("car-3", "mining")

    def renew() -> None:
        outpost.credentials.user = outpost.ceph.give_new_key(expired)

    outpost.trouble_is_said_counted_and_over(
        "these credentials ",  # denied, or not known: as the cache of the store has it
        "refused",
        begins=lambda: outpost.ceph.remove_key(expired),
        ends=renew,
    )
    outpost.is_as_if_undisturbed("car-3", undisturbed["car-3"])
    said = "".join(daemon.said() for daemon in outpost.system.daemons)
    for user in (expired, outpost.credentials.user):
        assert user.key_id not in said
        assert user.secret not in said


def test_an_object_replaced_while_it_is_read_is_never_mixed_with_its_successor(
    outpost: Outpost, undisturbed: dict[str, Undisturbed], tmp_path: Path
) -> None:
    outpost.proxy.in_next_body(key_of("car-4"), lambda: outpost.upload("car-4"))
    outpost.upload_another("car-4", tmp_path)
    outpost.is_as_if_undisturbed("car-4", undisturbed["car-4"])
    outpost.until_said(outpost.system.pool, "was replaced or deleted while it was read (car-4/")


def test_an_object_deleted_while_it_is_read_is_gone_with_the_next_listing(
    outpost: Outpost, tmp_path: Path
) -> None:
    deleted: list[bool] = []

    def happens() -> None:
        obstore.delete(outpost.ceph.store(outpost.logs), key_of("car-9"))
        deleted.append(True)

    outpost.proxy.in_next_body(key_of("car-9"), happens)
    outpost.upload_another("car-9", tmp_path)
    outpost.system.until(lambda: bool(deleted), "a read of it")
    outpost.until_said(outpost.system.pool, "was replaced or deleted while it was read (car-9/")
    outpost.system.until(lambda: "car-9/2026-03-02/drive" not in known_logs(outpost), "it is gone")
    assert outpost.system.client.status().parked == ()
    assert outpost.records("car-9") == {}


def known_logs(outpost: Outpost) -> set[str]:
    """Ids of the logs that the service knows."""
    return {log.log_id for log in outpost.system.client.status().logs}
