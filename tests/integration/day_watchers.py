"""Subscribers of the day: one who listens all day, one who is away over noon, those who come late.

Each keeps the records that are current, as `schemas/WIRE.md` tells him to.
"""

import threading
from collections.abc import Callable
from contextlib import closing
from typing import Final

import zenoh

from schemas.transport import keys
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT
from service.client import watch_scenes

Records = dict[str, bytes]
"""Scene id to record, of what is current."""

IDLE_S: Final = 0.5


class Watcher:
    """Listens, and can be told to stop and to resume after the last event that he handled.

    Attributes:
        current: What he holds.
        withdrawn: Events that took a scene back.
        seqs: Numbers of the events, as they came.
    """

    def __init__(
        self,
        endpoint: str,
        *,
        on_scene: Callable[[str], None] = lambda _: None,
        on_service: Callable[[bool], None] = lambda _: None,
    ) -> None:
        """Prepare; `start` starts.

        Args:
            endpoint: Of the router.
            on_scene: Told of every event, in words.
            on_service: Told when the service is gone and back.
        """
        self.current: Records = {}
        self.withdrawn = 0
        self.seqs: list[int] = []
        self._endpoint, self._on_scene, self._on_service = endpoint, on_scene, on_service
        self._stop = threading.Event()
        self._thread = threading.Thread()

    def start(self) -> None:
        """Listen, from the beginning or after the last event."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, args=(self._stop,), daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Be away."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self, stop: threading.Event) -> None:
        for event in watch_scenes(
            [self._endpoint],
            since=self.seqs[-1] if self.seqs else None,
            stop=stop,
            idle_s=IDLE_S,
            on_service=self._on_service,
        ):
            self.seqs.append(event.seq)
            if event.score is None:
                self.withdrawn += 1
                self.current.pop(event.scene_id, None)
                self._on_scene(f"[{event.seq}] withdrawn  {event.scene_id}")
            else:
                self.current[event.scene_id] = event.record
                self._on_scene(f"[{event.seq}] {event.score.score:.3f}  {event.scene_id}")


def history(endpoint: str) -> Records:
    """Ask for the current scenes with Zenoh alone, as somebody who comes late."""
    with client_session([endpoint]) as session:
        replies = session.get(
            keys.all_scenes(root=DEFAULT_ROOT), consolidation=zenoh.ConsolidationMode.NONE
        )
        return {
            keys.scene_id_of(str(reply.ok.key_expr), root=DEFAULT_ROOT): reply.ok.payload.to_bytes()
            for reply in replies
            if reply.ok is not None
        }


def stock_subscriber(endpoint: str, *, until: Callable[[Records], bool]) -> Records:
    """Subscribe late with Zenoh's own AdvancedSubscriber, until what came satisfies or 20 s."""
    current: Records = {}
    changed = threading.Condition()

    def take(sample: zenoh.Sample) -> None:
        with changed:
            current[keys.scene_id_of(str(sample.key_expr), root=DEFAULT_ROOT)] = (
                sample.payload.to_bytes()
            )
            changed.notify_all()

    with closing(client_session([endpoint])) as session:
        zenoh.ext.declare_advanced_subscriber(
            session,
            keys.all_scenes(root=DEFAULT_ROOT),
            take,
            history=zenoh.ext.HistoryConfig(),
        )
        with changed:
            changed.wait_for(lambda: until(current), timeout=20)
            return dict(current)
