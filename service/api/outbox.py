"""Publisher of durable, numbered scenes: puts the ledger's events on the bus, in order."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

import structlog
import zenoh

from schemas.events import SceneNumber
from schemas.transport import keys
from schemas.transport.bus import RANKED, VERDICT, encoding_of, is_connected
from schemas.transport.wire import encode
from service.curation.selection import Selection
from service.store.ledger import Ledger, StoredScene

log = structlog.get_logger(__name__)

BATCH: Final = 256
"""Events per move of the durable cursor; after a kill up to this many are put twice."""


class Outbox:
    """Puts every event of the ledger once, or twice after a kill; never out of order.

    A put may be lost on its way, so subscribers that need all scenes ask for the history. The
    cursor only marks the events that need no further put.
    """

    def __init__(
        self,
        session: zenoh.Session,
        ledger: Ledger,
        *,
        root: str,
        on_fault: Callable[[], None] = lambda: None,
    ) -> None:
        """Keep the parts; `on_fault` is called for each event that the bus cannot carry."""
        self._session, self._ledger, self._root = session, ledger, root
        self._on_fault = on_fault

    def publish(self) -> None:
        """Publish every pending event, or stop when no router is connected."""
        while self.publish_some() + self.publish_verdicts():
            pass

    def publish_some(self) -> int:
        """Publish the next batch of events; return how many, 0 while no router is connected."""
        if not is_connected(self._session):
            return 0
        events = self._ledger.unpublished(BATCH)
        for event in events:
            self._put_or_skip(event)
        if events:
            self._ledger.mark_published(events[-1].seq)
            log.debug("scenes published", scenes=len(events), seq=events[-1].seq)
        return len(events)

    def publish_verdicts(self) -> int:
        """Publish the next batch of verdicts; return how many, 0 while no router is connected."""
        if not is_connected(self._session):
            return 0
        verdicts = self._ledger.verdicts.unpublished(BATCH)
        for verdict in verdicts:
            key = keys.verdict(root=self._root, scene_id=verdict.scene_id, ordinal=verdict.ordinal)
            self._session.put(
                key,
                encode(verdict),
                encoding=VERDICT,
                attachment=encode(SceneNumber(seq=verdict.ordinal)),
                congestion_control=zenoh.CongestionControl.DROP,
            )
        if verdicts:
            self._ledger.verdicts.mark_published(verdicts[-1].ordinal)
        return len(verdicts)

    def publish_selection(self, selection: Selection) -> None:
        """Put every scene of a stored selection to its key, best first."""
        for key, payload in selected_scenes(selection, root=self._root):
            self._session.put(key, payload, encoding=RANKED)

    def _put_or_skip(self, event: StoredScene) -> None:
        """Put an event; skip one of an earlier version whose names exceed the bounds."""
        try:
            self._put(event)
        except keys.KeyTooLongError as error:
            log.error("scene not published, ever", seq=event.seq, problem=str(error))
            self._on_fault()

    def _put(self, event: StoredScene) -> None:
        key = keys.scene(root=self._root, log_id=event.log_id, scene_id=event.scene_id)
        number = encode(SceneNumber(seq=event.seq))
        drop = zenoh.CongestionControl.DROP
        if event.withdrawn:
            self._session.delete(key, attachment=number, congestion_control=drop)
        else:
            self._session.put(
                key,
                event.record,
                encoding=encoding_of(event.record),
                attachment=number,
                congestion_control=drop,
            )


def selected_scenes(selection: Selection, *, root: str) -> Iterator[tuple[str, bytes]]:
    """Yield key and payload of every scene of a selection, best first.

    Scenes that the bus cannot carry are skipped; earlier versions stored names without a bound.
    """
    for scene in selection.scenes:
        with suppress(keys.KeyTooLongError):
            key = keys.selected(
                root=root, selection=selection.name, log_id=scene.log_id, scene_id=scene.scene_id
            )
            yield key, encode(scene)
