"""Bounded memory of raw records between their arrival on the bus and their commit."""

import sys
from collections import OrderedDict
from collections.abc import Iterable
from threading import Condition
from typing import Final

import zenoh

from schemas.canonical import sha256
from schemas.score import MAX_RECORD_BYTES

MOST_BYTES: Final = 64 * 1024 * 1024
"""Memory of all waiting records, bytes: about 10,000 of them. Dropped records are reported as
missing, and the worker sends them again.
"""

ENTRY_BYTES: Final = 320
"""Memory of an entry in addition to its record, bytes: the digest, a node of the ordered
dictionary, and its slot in the table. Measured: 300 bytes or less, for any record.
"""

MOST_PATIENT: Final = 8
"""Commits that wait for their records at a time, half of the threads that answer commits: forged
ones, whose records never come, leave the others to the workers.
"""


class Staging:
    """Keeps records by digest, and drops the oldest first; it gives no guarantee.

    The bound counts memory, not payload: a record of one byte takes some hundred bytes.

    Attributes:
        missed: Records that the bus is known to have lost on their way here.
    """

    def __init__(self, *, most_bytes: int = MOST_BYTES) -> None:
        self._records: OrderedDict[str, bytes] = OrderedDict()
        self._bytes, self._most_bytes, self._patient = 0, most_bytes, 0
        self._changed = Condition()
        self.missed = 0

    def on_miss(self, samples: int) -> None:
        """Count records that the bus lost; the commit that names them sends them again."""
        with self._changed:
            self.missed += samples

    def on_sample(self, sample: zenoh.Sample) -> None:
        """Keep a sample from the bus; the callback of the subscription."""
        if sample.kind == zenoh.SampleKind.PUT and 0 < len(sample.payload) <= MAX_RECORD_BYTES:
            self.add(sample.payload.to_bytes())

    @property
    def waiting_bytes(self) -> int:
        """Memory of all records that wait for their commit, bytes."""
        with self._changed:
            return self._bytes

    @property
    def patient(self) -> int:
        """Number of commits that wait for their records."""
        with self._changed:
            return self._patient

    def add(self, record: bytes) -> None:
        """Keep a record; a repeated one is kept once."""
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
        """Return the records with these digests that have arrived.

        Args:
            digests: Digests in a manifest.
            patience_s: Longest wait for the rest, seconds. A commit may overtake the last record,
                since records and requests arrive on separate threads. While `MOST_PATIENT` wait,
                there is no wait: the records that are missing are asked for.
        """
        wanted = tuple(digests)
        with self._changed:
            if patience_s > 0 and self._patient < MOST_PATIENT:
                self._patient += 1
                try:
                    self._changed.wait_for(
                        lambda: all(digest in self._records for digest in wanted), patience_s
                    )
                finally:
                    self._patient -= 1
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
    """Memory that a record takes here, its entry included, bytes."""
    return sys.getsizeof(record) + ENTRY_BYTES
