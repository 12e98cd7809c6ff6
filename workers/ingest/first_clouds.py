"""First clouds: the earliest readable clouds of a topic, from any chunks."""

from bisect import insort
from typing import Final

import numpy as np

from schemas.work import Channel
from workers.errors import CloudUnreadableError
from workers.ingest.limits import MAX_TRIED
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import DecodedCloud, decode_cloud
from workers.ingest.scanned_chunks import ScannedChunk
from workers.ingest.topics import ids_in

MAX_CLOUDS: Final = 16
"""Clouds of one topic that are examined; a chunk of small messages may contain hundreds."""


class EarliestClouds:
    """At most `MAX_CLOUDS` clouds of one topic, by log time.

    Attributes:
        first_ns: Earliest log time of any message of the topic, readable or not; None before one.
    """

    def __init__(self, channel: Channel, most_bytes: int) -> None:
        """Begin with none.

        Args:
            channel: The topic.
            most_bytes: Bytes of clouds that are kept, unless a single one is larger.
        """
        self.first_ns: int | None = None
        self._channel, self._left_bytes = channel, most_bytes
        self._found: list[tuple[int, int, DecodedCloud]] = []
        self._arrived, self._tried = 0, 0
        self._full = False

    @property
    def clouds(self) -> list[tuple[int, DecodedCloud]]:
        """Return log time and cloud of each, earliest first."""
        return [(log_time_ns, cloud) for log_time_ns, _, cloud in self._found]

    def add(self, chunk: ScannedChunk) -> None:
        """Add the clouds of a chunk that are earlier than the kept ones, or still wanted."""
        ids = sorted(ids_in(self._channel, chunk.part))
        mine = np.flatnonzero(np.isin(chunk.channel_ids, ids))
        ordered = mine[np.argsort(chunk.log_times_ns[mine], kind="stable")]
        if len(ordered):
            first_ns = int(chunk.log_times_ns[ordered[0]])
            self.first_ns = first_ns if self.first_ns is None else min(first_ns, self.first_ns)
        for number in ordered.tolist():
            log_time_ns = int(chunk.log_times_ns[number])
            if self._tried >= MAX_TRIED or self._is_late(log_time_ns):
                return
            start = int(chunk.offsets[number])
            data = chunk.records[start : start + int(chunk.lengths[number])]
            try:
                cloud = decode_cloud(RawMessage(self._channel, log_time_ns, data))
            except CloudUnreadableError:
                self._tried += 1
                continue  # mining reads it again and records the damage
            self._take(log_time_ns, cloud)

    def _is_late(self, log_time_ns: int) -> bool:
        return self._full and log_time_ns >= self._found[-1][0]

    def _take(self, log_time_ns: int, cloud: DecodedCloud) -> None:
        insort(self._found, (log_time_ns, self._arrived, cloud), key=lambda each: each[:2])
        self._arrived += 1
        self._left_bytes -= len(cloud.data)
        while len(self._found) > MAX_CLOUDS or (self._left_bytes < 0 and len(self._found) > 1):
            _, _, late = self._found.pop()
            self._left_bytes += len(late.data)
            self._full = True
        self._full = self._full or len(self._found) == MAX_CLOUDS
