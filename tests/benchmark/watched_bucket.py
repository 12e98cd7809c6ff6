"""Listing of a large bucket, and the watch of it by notifications: `--objects 100000`.

It runs a Ceph gateway, fills a bucket with tiny objects, lists it into a ledger, and has the
gateway post each further change to the page of a real service. Requests are counted by a proxy.
"""

import argparse
import asyncio
import json
import resource
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import obstore

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from service.app import Service
from service.background.bucket_notices import PATH, BucketNotices
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from tests.integration.faulty_proxy import FaultyProxy
from tests.integration.object_store import Ceph
from tests.integration.running import until

AT_ONCE = 64


def watched(ceph: Ceph, folder: Path, *, objects: int, changes: int) -> dict[str, float]:
    """Measure one bucket.

    Args:
        ceph: A running store.
        folder: For the state.
        objects: Objects in the bucket at the start.
        changes: Objects that are put, and then deleted, one after the other.

    Returns:
        Seconds, requests and memory, by name.
    """
    name = ceph.make_bucket()
    began_s = time.monotonic()
    asyncio.run(_fill(ceph, name, objects))
    found: dict[str, float] = {"objects": objects, "fill_s": time.monotonic() - began_s}
    with ExitStack() as opened:
        proxy = opened.enter_context(FaultyProxy(ceph.endpoint))
        bucket = open_bucket(f"s3://{name}", options=ceph.options() | {"endpoint": proxy.endpoint})
        began_s, cpu_s = time.monotonic(), time.process_time()
        assert sum(1 for _ in bucket.list()) == objects
        found["list_s"] = time.monotonic() - began_s
        found["list_requests"] = proxy.requests
        world = World.on(open_store(folder))
        opened.callback(world.store.close)
        endpoint = free_endpoint()
        opened.enter_context(router_session([endpoint]))
        session = opened.enter_context(client_session([endpoint]))
        settings = Settings(bucket=bucket.url, artifacts="memory://", settle_s=0.0)
        notices = BucketNotices(bucket.url)
        http = opened.enter_context(HttpEndpoint("127.0.0.1:0", {}, posts={PATH: notices.answer}))
        began_s, cpu_s = time.monotonic(), time.process_time()
        service = Service(settings, session, world.ledger, bucket=bucket, notices=notices)
        opened.enter_context(service)
        found["listed_into_ledger_s"] = time.monotonic() - began_s
        found["listed_into_ledger_cpu_s"] = time.process_time() - cpu_s
        ceph.notify(name, f"{http.url}{PATH}")
        before, cpu_s = proxy.requests, time.process_time()
        store, taken = ceph.store(name), []
        for number in range(changes):
            key = f"new/drive-{number}.mcap"
            began_s = time.monotonic()
            obstore.put(store, key, f"new {number}".encode())
            until(lambda key=key: _is_listed(world, key), key)  # type: ignore[misc]
            taken.append(time.monotonic() - began_s)
        for number in range(changes):
            ceph.delete(name, f"new/drive-{number}.mcap")
        until(lambda: not _is_listed(world, f"new/drive-{changes - 1}.mcap"), "deletion")
        found["changes"] = 2 * changes
        found["requests_for_changes"] = proxy.requests - before
        found["put_to_ledger_median_s"] = sorted(taken)[len(taken) // 2]
        found["cpu_s_per_change"] = (time.process_time() - cpu_s) / (2 * changes)
        found["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return found


async def _fill(ceph: Ceph, name: str, objects: int) -> None:
    store, places = ceph.store(name), asyncio.Semaphore(AT_ONCE)

    async def put(number: int) -> None:
        async with places:
            key = f"car-{number % 97}/drive-{number:06d}.mcap"
            await obstore.put_async(store, key, f"log {number}".encode())

    await asyncio.gather(*(put(number) for number in range(objects)))


def _is_listed(world: World, key: str) -> bool:
    with world.store.reading() as connection:
        return (
            connection.exec_driver_sql(
                "SELECT 1 FROM recordings WHERE log_id = ? AND is_current = 1",
                (key.removesuffix(".mcap"),),
            ).first()
            is not None
        )


def main() -> None:
    """Run the measurement and print it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=100_000)
    parser.add_argument("--changes", type=int, default=50)
    parser.add_argument("--servers", type=Path, default=Path("../shared/servers"))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="ceph-") as folder:
        ceph = Ceph(asked.servers, Path(folder))
        try:
            ceph.up()
            with tempfile.TemporaryDirectory() as state:
                found = watched(ceph, Path(state), objects=asked.objects, changes=asked.changes)
        finally:
            ceph.down()
    sys.stdout.write(f"{json.dumps({name: round(value, 3) for name, value in found.items()})}\n")


if __name__ == "__main__":
    main()
