"""History of scenes from the ledger, for subscribers that start late.

A publisher's cache ends with its process, so the service answers history requests itself. Two forms
are answered. Ours is `scene/**?since=N` (`schemas/WIRE.md`). The other is the request that an
AdvancedSubscriber with a history sends to publishers' caches, so that a stock subscriber needs no
code of ours.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from typing import Final

import zenoh

from schemas.bounds import MAX_INTEGER, MAX_NEWEST
from schemas.errors import PermanentError
from schemas.events import SceneNumber
from schemas.transport import keys
from schemas.transport.bus import RANKED, VERDICT, encoding_of
from schemas.transport.wire import encode
from schemas.verdict import VerdictRecord
from service.api.outbox import selected_scenes
from service.api.request_queue import RequestQueue
from service.store.ledger import Ledger, StoredScene

PAGE: Final = 512
"""Scenes read from the ledger at once: bounds memory, not the answer."""


class History:
    """Answers history requests from the ledger."""

    def __init__(self, session: zenoh.Session, ledger: Ledger, *, root: str) -> None:
        self._session, self._ledger, self._root = session, ledger, root

    def declare(self, requests: RequestQueue) -> None:
        """Register the handlers."""
        requests.declare_history(keys.all_scenes(root=self._root), self.answer)
        requests.declare_history(keys.scene_cache(root=self._root), self.answer_as_cache)
        requests.declare_history(keys.all_selected(root=self._root), self.answer_selected)
        requests.declare_history(keys.all_verdicts(root=self._root), self.answer_verdicts)

    def answer(self, query: zenoh.Query) -> None:
        """Reply with scenes in the order of their numbers, as the parameters request.

        `since=N` gives the current scenes with a greater number, all without it; with `withdrawn=1`
        also every withdrawal with a greater number, as a delete. `most=M` stops after so many
        replies. `newest=N` gives the N current scenes with the highest numbers. A key expression
        that is narrower than all scenes gets those that it matches.

        Raises:
            PermanentError: If a parameter is no number within its bounds, or `since` is beyond the
                last one.
        """
        newest = _number(query, "newest", most=MAX_NEWEST)
        most = _number(query, "most")
        since = _number(query, "since") or 0
        withdrawn = _number(query, "withdrawn", most=1) or 0
        if since > (last := self._ledger.last_seq()):
            raise PermanentError(
                f"no event {since} here, the last is {last}: these scenes are from another "
                "ledger; drop yours, and begin again with since=0"
            )
        if newest is not None:
            events: Iterator[StoredScene] = iter(self._ledger.newest_scenes(newest))
        elif withdrawn:
            events = self._pages(self._ledger.events_since, since, most)
        else:
            events = self._pages(self._ledger.scenes_since, since, most)
        asked = (
            (event, key) for event, key in self._with_keys(events) if query.key_expr.intersects(key)
        )
        for event, key in islice(asked, most):
            if event.withdrawn:
                query.reply_del(key, attachment=_attachment(event))
            else:
                query.reply(
                    key,
                    event.record,
                    encoding=encoding_of(event.record),
                    attachment=_attachment(event),
                )

    def answer_as_cache(self, query: zenoh.Query) -> None:
        """Reply as the caches of publishers would: every current scene once, with a timestamp.

        The subscriber keeps replies back until the answer ends and sorts them by timestamp, which
        rises with the number here. A key has one current record, so the subscriber's limit of
        samples per key (`_max`) is always met. Its limit of age (`_time`) is ignored: all scenes
        are given.
        """
        for scene, key in self._with_keys(self._pages(self._ledger.scenes_since, 0)):
            query.reply(
                key,
                scene.record,
                encoding=encoding_of(scene.record),
                attachment=_attachment(scene),
                timestamp=self._session.new_timestamp(),
            )

    def answer_selected(self, query: zenoh.Query) -> None:
        """Reply with the scenes of every stored selection that the key expression matches."""
        for selection in self._ledger.selections.all():
            for key, payload in selected_scenes(selection, root=self._root):
                if query.key_expr.intersects(key):
                    query.reply(key, payload, encoding=RANKED)

    def answer_verdicts(self, query: zenoh.Query) -> None:
        """Reply with verdicts in the order of their numbers, undone ones and undos included.

        `since=N` gives those with a greater number, `most=M` stops after so many.

        Raises:
            PermanentError: If a parameter is no number within its bounds, or `since` is beyond the
                last one.
        """
        most, since = _number(query, "most"), _number(query, "since") or 0
        if since > (last := self._ledger.verdicts.last()):
            raise PermanentError(
                f"no verdict {since} here, the last is {last}: these verdicts are from another "
                "ledger; drop yours, and begin again with since=0"
            )
        for verdict, key in islice(self._verdicts_with_keys(query, since), most):
            query.reply(
                key,
                encode(verdict),
                encoding=VERDICT,
                attachment=encode(SceneNumber(seq=verdict.ordinal)),
            )

    def _verdicts_with_keys(
        self, query: zenoh.Query, since: int
    ) -> Iterator[tuple[VerdictRecord, str]]:
        while page := self._ledger.verdicts.since(since, PAGE):
            for verdict in page:
                key = keys.verdict(
                    root=self._root, scene_id=verdict.scene_id, ordinal=verdict.ordinal
                )
                if query.key_expr.intersects(key):
                    yield verdict, key
            since = page[-1].ordinal

    def _pages(
        self, read: Callable[[int, int], list[StoredScene]], seq: int, most: int | None = None
    ) -> Iterator[StoredScene]:
        limit = PAGE if most is None else max(1, min(PAGE, most))
        while page := read(seq, limit):
            yield from page
            seq = page[-1].seq

    def _with_keys(self, events: Iterable[StoredScene]) -> Iterator[tuple[StoredScene, str]]:
        """Pair events with their keys; skip those that the bus cannot carry."""
        for event in events:
            with suppress(keys.KeyTooLongError):  # the outbox has said which
                yield (
                    event,
                    keys.scene(root=self._root, log_id=event.log_id, scene_id=event.scene_id),
                )


def _attachment(scene: StoredScene) -> bytes:
    return encode(SceneNumber(seq=scene.seq))


def _number(query: zenoh.Query, name: str, *, most: int = MAX_INTEGER) -> int | None:
    text = query.parameters.get(name)
    if text is None:
        return None
    if not text.isdecimal() or len(text) > len(str(MAX_INTEGER)) or int(text) > most:
        shown = text if len(text) <= 40 else f"{text[:40]}..."
        raise PermanentError(f"{name} must be a number, 0 to {most}, got {shown!r}")
    return int(text)
