"""Router and service in the test's own process, and clients that watch them from threads."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from schemas.transport import keys
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from service.app import Service
from service.client import watch_scenes
from service.client.merge import SceneEvent
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint

ROOT: Final = keys.DEFAULT_ROOT
DEADLINE_S: Final = 30.0


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {DEADLINE_S:g} s: {what}"
        threading.Event().wait(0.01)


class Running:
    """Router and service of one test, each of which can be taken away and brought back."""

    def __init__(self, folder: Path) -> None:
        self.logs = folder / "logs"
        self.logs.mkdir()
        (folder / "state").mkdir()
        self.endpoint = free_endpoint()
        self.world = World.on(open_store(folder / "state"))
        self.settings = Settings(
            bucket=str(self.logs),
            artifacts=str(folder / "overlays"),
            supervised="recorded",
            list_interval_s=0.1,
            settle_s=0.0,
        )
        self._router = ExitStack()
        self._service = ExitStack()

    def add_log(self, log_id: str) -> None:
        (self.logs / f"{log_id}.mcap").write_bytes(log_id.encode())

    def start_router(self) -> None:
        self._router.enter_context(router_session([self.endpoint]))

    def stop_router(self) -> None:
        self._router.close()

    def start_service(self) -> None:
        session = self._service.enter_context(client_session([self.endpoint]))
        self.service = self._service.enter_context(
            Service(
                self.settings,
                session,
                self.world.ledger,
                bucket=open_bucket(str(self.logs)),
            )
        )

    def stop_service(self) -> None:
        self._service.close()

    def close(self) -> None:
        self._service.close()
        self._router.close()
        self.world.store.close()

    def watching(self, **how: Any) -> "Watching":
        return Watching(self.endpoint, **how)

    def log_ids(self) -> set[str]:
        return {log.log_id for log in self.world.ledger.status().logs}


@contextmanager
def two_logs(folder: Path) -> Iterator[Running]:
    """Router and service on a bucket of the logs `a` and `b`, of which nothing is mined."""
    parts = Running(folder)
    for log_id in ("a", "b"):
        parts.add_log(log_id)
    parts.start_router()
    parts.start_service()
    try:
        yield parts
    finally:
        parts.close()


class Watching:
    """A client that watches from a thread of its own."""

    def __init__(self, endpoint: str, **how: Any) -> None:
        self.events: list[SceneEvent] = []
        self.said: list[bool] = []
        self._stop = threading.Event()
        self._scenes = watch_scenes(
            [endpoint],
            root=ROOT,
            stop=self._stop,
            idle_s=0.3,
            on_service=self.said.append,
            **how,
        )
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Watching":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        for event in self._scenes:
            self.events.append(event)

    def seqs(self) -> list[int]:
        return [event.seq for event in self.events]

    def digests(self) -> dict[str, str]:
        return {event.scene_id: event.sha256 for event in self.events}
