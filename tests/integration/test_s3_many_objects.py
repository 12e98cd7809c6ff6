"""Ten thousand objects: listed whole and in order, and a service that keeps answering."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT
from service.app import Service
from service.client import ControlClient
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World, plan_of
from tests.free_ports import free_endpoint
from tests.integration.faulty_proxy import FaultyProxy
from tests.integration.object_store import Ceph
from tests.integration.running import until

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

OBJECTS = 10_000
PAGES = 10
"""A listing gives a thousand objects at a time."""

KEYS = [f"car-{n % 7}/2026-03-{n % 28 + 1:02d}/drive-{n:05d}.mcap" for n in range(OBJECTS)]


@pytest.fixture(scope="module")
def many(ceph: Ceph) -> str:
    """Name of a bucket with ten thousand tiny logs, none of which is one."""
    name = ceph.make_bucket()
    bucket = ceph.open(name)
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(lambda n: bucket.put(KEYS[n], f"log {n:05d}".encode()), range(OBJECTS)))
    return name


def through(proxy: FaultyProxy, ceph: Ceph, name: str) -> Bucket:
    """Open a bucket behind a proxy that counts requests."""
    return open_bucket(f"s3://{name}", options=ceph.options() | {"endpoint": proxy.endpoint})


@contextmanager
def serving(bucket: Bucket, folder: Path) -> Iterator[tuple[World, ControlClient]]:
    """Run a service that lists all the time, and give its ledger and a client."""
    with ExitStack() as opened:
        world = World.on(
            open_store(folder),
            planner=lambda recording: plan_of(recording.log_id, refused="no log"),
        )
        opened.callback(world.store.close)
        endpoint = free_endpoint()
        opened.enter_context(router_session([endpoint]))
        session = opened.enter_context(client_session([endpoint]))
        settings = Settings(
            bucket=bucket.url, artifacts="memory://", list_interval_s=0.1, settle_s=0.0
        )
        service = Service(settings, session, world.ledger, bucket=bucket)
        opened.enter_context(service)
        yield world, ControlClient([endpoint], root=DEFAULT_ROOT)


def test_a_listing_gives_every_object_once_in_order_and_can_go_on_after_a_key(
    ceph: Ceph, many: str
) -> None:
    bucket, ordered = ceph.open(many), sorted(KEYS)
    with FaultyProxy(ceph.endpoint) as proxy:
        listed = list(through(proxy, ceph, many).list())
        assert PAGES <= proxy.requests <= PAGES + 1, "the last page may be empty"
    assert [found.key for found in listed] == ordered
    assert {found.size for found in listed} == {9}
    for begin in (0, 999, 1000, 5432, OBJECTS - 1):
        after = bucket.list(start_after=ordered[begin])
        assert [found.key for found in after] == ordered[begin + 1 :]
    assert [f.key for f in bucket.list("car-3")] == [k for k in ordered if k.startswith("car-3/")]


def test_a_service_with_ten_thousand_logs_answers_and_plans_each_once(
    ceph: Ceph, many: str, tmp_path: Path
) -> None:
    with (
        FaultyProxy(ceph.endpoint) as proxy,
        serving(through(proxy, ceph, many), tmp_path) as (world, client),
    ):
        begin = proxy.requests
        refused: list[str] = []
        while len(refused) < 100 or proxy.requests < begin + 3 * PAGES:
            lease = world.plan_lease()
            refused.append(lease.recording.log_id)
            assert world.commit_plan(lease).ok
        assert len(set(refused)) == len(refused), "a listing plans nothing again"
        so_far = {"refused": len(refused), "waiting": OBJECTS - len(refused)}
        assert client.status().logs_by_state == so_far
        until(lambda: proxy.requests >= begin + 5 * PAGES, "two more listings")
        assert client.status().logs_by_state == so_far
