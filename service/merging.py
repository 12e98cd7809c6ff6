"""Scenes published now and scenes fetched from the history, merged: each once, none missing."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from schemas.score import SceneScore
from schemas.wire import decode


@dataclass(frozen=True, slots=True)
class SceneEvent:
    """One scene as it was published, or the news that it is no longer current.

    Attributes:
        seq: Number of the event in the service's ledger.
        scene_id: `<log_id>/<lidar>/<start_ns>`.
        record: Bytes as published; empty when withdrawn.
        sha256: Digest of the record; empty when withdrawn.
    """

    seq: int
    scene_id: str
    record: bytes = b""
    sha256: str = ""

    @property
    def withdrawn(self) -> bool:
        """Whether the scene is no longer current: its log was replaced or deleted."""
        return not self.record

    @property
    def score(self) -> SceneScore | None:
        """The record, decoded; None when withdrawn."""
        return decode(SceneScore, self.record) if self.record else None


class SceneMerge:
    """Merges what is published now with what is fetched from the history. Each scene once.

    The history comes in the order of its numbers, so that an answer cut short by a kill is still
    complete up to its last scene; `_complete_to` never goes beyond what is known to be complete.
    """

    def __init__(
        self, fetch: Callable[[dict[str, int]], Iterator[SceneEvent]], *, page: int
    ) -> None:
        """Take how to ask the history, and for how many scenes at once.

        Args:
            fetch: Asked for `{"since": N, "most": M}` or `{"newest": N}`.
            page: Scenes in one question.
        """
        self._fetch, self._page = fetch, page
        self._seen: dict[str, tuple[int, str]] = {}
        self._from = 0
        self._complete_to = 0

    def begin(self, history: int | None) -> Iterator[SceneEvent]:
        """Fetch the past: all of it, or the newest few."""
        if history is None:
            yield from self.catch_up()
            return
        newest = list(self._fetch({"newest": max(history, 1)}))
        if newest:
            self._complete_to = newest[-1].seq
            self._from = newest[0].seq if history else self._complete_to + 1
        yield from self._new(newest[:history])

    def catch_up(self) -> Iterator[SceneEvent]:
        """Fetch whatever is newer than what is known to be complete."""
        while True:
            begun_at = self._complete_to
            for event in self._fetch({"since": begun_at, "most": self._page}):
                self._complete_to = max(self._complete_to, event.seq)
                yield from self._new([event])
            if self._complete_to == begun_at:
                return

    def take(self, event: SceneEvent) -> Iterator[SceneEvent]:
        """Take an event that was just published; fetch first what it shows to be missing."""
        if event.seq > self._complete_to + 1:
            yield from self.catch_up()
        if event.seq == self._complete_to + 1:
            self._complete_to = event.seq
        yield from self._new([event])

    def _new(self, events: Sequence[SceneEvent]) -> Iterator[SceneEvent]:
        for event in events:
            seq, digest = self._seen.get(event.scene_id, (0, None))
            if event.seq >= self._from and event.seq > seq:
                self._seen[event.scene_id] = (event.seq, event.sha256)
                if event.sha256 != digest:
                    yield event
