"""Scenes from the history, asked for when something is published: in order, each event once."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from schemas.canonical import sha256
from schemas.score import SceneScore


@dataclass(frozen=True, slots=True)
class SceneEvent:
    """One scene as it was published, or the news that it is no longer current.

    Attributes:
        seq: Number of the event in the service's ledger.
        scene_id: `<log_id>/<lidar>/<start_ns>`.
        record: Bytes as published; empty when withdrawn.
        sha256: Digest of the record; empty when withdrawn.
        score: The record, decoded; None when withdrawn.
        unreadable: The record is none that this version knows: only its number counts.
    """

    seq: int
    scene_id: str
    record: bytes = b""
    sha256: str = ""
    score: SceneScore | None = None
    unreadable: bool = False

    @property
    def log_id(self) -> str:
        """The recording that the scene is of."""
        return self.scene_id.rsplit("/", maxsplit=2)[0]

    @property
    def withdrawn(self) -> bool:
        """Whether the scene is no longer current: its log was replaced or deleted."""
        return not self.record


Fetch = Callable[[Mapping[str, int]], Sequence[SceneEvent]]
"""Asks the history, by parameters of the wire; what comes is complete up to its last event."""


class SceneMerge:
    """Passes on the events of the history, fetched when one is heard to have been published.

    Events leave in the order of their numbers, so that whoever was killed goes on after the last
    number he has noted. What is published is only heard, never passed on: anybody on the bus can
    publish under the key of a scene, with any number, while the history comes from the ledger.

    Attributes:
        complete_to: Number up to which every event has been passed on.
    """

    def __init__(self, fetch: Fetch, *, page: int, since: int = 0) -> None:
        """Take how to ask the history, for how many events at once, and where to begin."""
        self._fetch, self._page = fetch, page
        self.complete_to = since
        self._newest = since

    @property
    def is_behind(self) -> bool:
        """Whether a number was heard that has not been passed on, nor been asked for in vain."""
        return self._newest > self.complete_to

    def begin(self, newest: int) -> Sequence[SceneEvent] | None:
        """Begin with the newest few current scenes.

        Returns:
            Those scenes; None if none came, because there is none or nobody answered.
        """
        found = self._fetch({"newest": max(newest, 1)})
        if not found:
            return None
        self.complete_to = found[-1].seq
        return [event for event in found[-newest:] if not event.unreadable] if newest else []

    def hear(self, seq: int) -> None:
        """Note the number of an event that was just published: `catch_up` is due if `is_behind`."""
        self._newest = max(self._newest, seq)

    def catch_up(self) -> Iterator[SceneEvent]:
        """Fetch, page by page, every event after the last one passed on.

        A number that the history does not know when it is asked is forgotten: it was made up, or
        its event comes with the next question.
        """
        while True:
            begun_at = self.complete_to
            page = self._fetch({"since": begun_at, "most": self._page, "withdrawn": 1})
            for event in page:
                if event.seq > self.complete_to:
                    self.complete_to = event.seq
                    if not event.unreadable:
                        yield event
            if self.complete_to == begun_at:
                self._newest = begun_at
                return
            if len(page) < self._page and not self.is_behind:
                return


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which scenes a subscriber wants.

    Attributes:
        log: Pattern that the log id must match whole; `*` also crosses `/`.
        vehicles: Only of these; empty: of all.
        min_score: Only scenes that score at least so much.
    """

    log: str = "*"
    vehicles: frozenset[str] = frozenset()
    min_score: float = 0.0

    def has_log(self, event: SceneEvent) -> bool:
        """Whether the event is of a log that is wanted."""
        return fnmatchcase(event.log_id, self.log)

    def has(self, event: SceneEvent) -> bool:
        """Whether the event brings a scene that is wanted."""
        score = event.score
        return (
            score is not None
            and score.score >= self.min_score
            and (not self.vehicles or score.vehicle in self.vehicles)
            and self.has_log(event)
        )


class Holding:
    """What a subscriber has been given and not been told to drop: decides what is news to him.

    Of a scene are kept 16 bytes of the digest of its id, and 16 of the digest of its record: with
    what Python adds 171 bytes, measured, so that a million scenes take 171 MB.
    """

    def __init__(self, wanted: Wanted, *, resumed: bool) -> None:
        """Take what is wanted, and whether an earlier life of the subscriber was given scenes."""
        self._wanted, self._resumed = wanted, resumed
        self._held: dict[bytes, bytes] = {}

    def news(self, event: SceneEvent) -> SceneEvent | None:
        """Return the event if it is news, as a withdrawal if a scene is no longer wanted.

        A withdrawal of a scene that was never given is news only to somebody who has resumed: an
        earlier life may have been given it.
        """
        key = _short(sha256(event.scene_id.encode()))
        held = self._held.get(key)
        if self._wanted.has(event):
            digest = _short(event.sha256)
            if held == digest:
                return None  # the same record again, after a revision went and came back
            self._held[key] = digest
            return event
        may_hold = self._resumed and event.withdrawn and self._wanted.has_log(event)
        if not (held or (held is None and may_hold)):
            return None
        if self._resumed:
            self._held[key] = b""  # told once
        else:
            del self._held[key]
        return replace(event, record=b"", sha256="", score=None)


def _short(digest: str) -> bytes:
    return bytes.fromhex(digest[:32])
