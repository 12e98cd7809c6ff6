"""Raw records between their arrival on the bus and the commit that names them; bounded memory."""

import sys
from collections import OrderedDict
from collections.abc import Iterable
from threading import Condition
from typing import Final

import zenoh

from schemas.canonical import sha256
from schemas.score import MAX_RECORD_BYTES

MOST_BYTES: Final = 64 * 1024 * 1024
"""Some ten thousand records; what is dropped is named missing, and its worker sends it again."""

ENTRY_BYTES: Final = 320
"""What an entry holds besides its record: the digest, a node of the ordered dictionary, and its
place in the table. Measured: 300 bytes and less, whatever the record."""


class Staging:
    """Keeps records by digest, oldest dropped first. Nothing here is a promise.

    What is bounded is the memory that is held: a record of one byte costs some hundred.

    Attributes:
        missed: Records that the bus lost for good on their way here, as far as it noticed.
    """

    def __init__(self, *, most_bytes: int = MOST_BYTES) -> None:
        self._records: OrderedDict[str, bytes] = OrderedDict()
        self._bytes, self._most_bytes = 0, most_bytes
        self._changed = Condition()
        self.missed = 0

    def on_miss(self, samples: int) -> None:
        """Count what the bus lost; the commit that names it brings it all the same."""
        with self._changed:
            self.missed += samples

    def on_sample(self, sample: zenoh.Sample) -> None:
        """Take a sample from the bus: the callback of the subscription."""
        if sample.kind == zenoh.SampleKind.PUT and 0 < len(sample.payload) <= MAX_RECORD_BYTES:
            self.add(sample.payload.to_bytes())

    @property
    def waiting_bytes(self) -> int:
        """Memory of all that waits for its commit."""
        with self._changed:
            return self._bytes

    def add(self, record: bytes) -> None:
        """Keep a record; the same one twice is one."""
        digest = sha256(record)
        with self._changed:
            self._forget(digest)
            self._records[digest] = record
            self._bytes += held_bytes(record)
            while self._bytes > self._most_bytes:
                _, dropped = self._records.popitem(last=False)
                self._bytes -= held_bytes(dropped)
            self._changed.notify_all()

    def collect(self, digests: Iterable[str], *, patience_s: float = 0.0) -> dict[str, bytes]:
        """Return those of these records that are here.

        Args:
            digests: What a manifest names.
            patience_s: Wait so long for the rest: a commit may overtake the last record, since
                records and questions arrive on threads of their own.
        """
        wanted = tuple(digests)
        with self._changed:
            self._changed.wait_for(
                lambda: all(digest in self._records for digest in wanted), timeout=patience_s
            )
            return {digest: self._records[digest] for digest in wanted if digest in self._records}

    def discard(self, digests: Iterable[str]) -> None:
        """Forget records whose commit is on disk."""
        with self._changed:
            for digest in digests:
                self._forget(digest)

    def _forget(self, digest: str) -> None:
        dropped = self._records.pop(digest, None)
        if dropped is not None:
            self._bytes -= held_bytes(dropped)


def held_bytes(record: bytes) -> int:
    """Memory that a record takes here, its entry included."""
    return sys.getsizeof(record) + ENTRY_BYTES
