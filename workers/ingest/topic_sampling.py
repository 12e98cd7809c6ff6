"""Topic sampling: a log's first clouds show its lidars, its start, and the delays of log times."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from schemas.work import ChunkRef, Damage
from workers.errors import ChunkUnreadableError
from workers.ingest.chunk import messages_in
from workers.ingest.damage import damaged_chunk
from workers.ingest.first_clouds import EarliestClouds
from workers.ingest.frames import frame_stamp_ns
from workers.ingest.limits import MAX_SAMPLE_BYTES
from workers.ingest.log_index import LogIndex
from workers.ingest.messages import MAX_TIME_NS
from workers.ingest.pointcloud import DecodedCloud
from workers.ingest.records import RecordMalformedError
from workers.ingest.scanned_chunks import ScannedChunks
from workers.ingest.shard_windows import StampBounds
from workers.ingest.topics import Topic, chunks_of

_CLOCK_MARGIN_NS: Final = 50_000_000
"""Variation of delays beyond the sampled ones, in logs whose stamps and log times differ."""
_MAX_CLOCK_SPREAD_NS: Final = 1_000_000_000
"""Stamps farther than this from the usual delay are outliers, not jitter."""
_STEP_MARGIN: Final = 0.9
"""Share of the shortest sampled step below which no two frames follow: motors hold their speed."""


@dataclass(slots=True, eq=False)
class Sample:
    """The first messages of one topic, in the order of their log times.

    Attributes:
        topic: Their topic.
        log_times_ns: Log time of each.
        stamps_ns: Frame time of each, as in mining.
        clouds: The messages, decoded.
        later_clouds: Clouds from elsewhere in the log, where some were needed.
        later_delays_ns: Delays from their stamps to their log times.
    """

    topic: Topic
    log_times_ns: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    clouds: list[DecodedCloud] = field(default_factory=list)
    later_clouds: list[DecodedCloud] = field(default_factory=list)
    later_delays_ns: list[int] = field(default_factory=list)

    @property
    def by_log_time(self) -> bool:
        """True if the sensor's clock jumps between the log's begin and end.

        Its stamps then do not relate to the index, and log times are used.
        """
        usual_ns = self.usual_delay_ns
        return any(
            abs(delay_ns - usual_ns) > _MAX_CLOCK_SPREAD_NS for delay_ns in self.later_delays_ns
        )

    @property
    def first_stamp_ns(self) -> int:
        """Time of the first frame with the usual delay."""
        if self.by_log_time:
            return self.log_times_ns[0]
        usual_ns = self.usual_delay_ns
        return next(
            stamp_ns
            for stamp_ns, log_time_ns in zip(self.stamps_ns, self.log_times_ns, strict=True)
            if abs(log_time_ns - stamp_ns - usual_ns) <= _MAX_CLOCK_SPREAD_NS
        )

    @property
    def bounds(self) -> StampBounds:
        """Range of delays from stamps to log times, with a margin where they differ at all."""
        if self.by_log_time:
            return StampBounds()
        usual_ns = self.usual_delay_ns
        delays_ns = [
            delay_ns
            for delay_ns in (*self._delays_ns(), *self.later_delays_ns)
            if abs(delay_ns - usual_ns) <= _MAX_CLOCK_SPREAD_NS
        ]
        least_ns, most_ns = min(delays_ns), max(delays_ns)
        if least_ns == most_ns == 0:
            return StampBounds()
        margin_ns = max(_CLOCK_MARGIN_NS, most_ns - least_ns)
        return StampBounds(least_ns - margin_ns, most_ns + margin_ns)

    @property
    def clocks_differ(self) -> bool:
        """True unless log times equal the stamps."""
        return self.bounds != StampBounds()

    @property
    def least_step_ns(self) -> int:
        """Shortest step between frames, with a margin; 0 where a single one was sampled."""
        steps_ns = np.diff(self.stamps_ns)
        rising_ns = steps_ns[steps_ns > 0]
        return int(rising_ns.min() * _STEP_MARGIN) if len(rising_ns) else 0

    def _delays_ns(self) -> list[int]:
        return [
            log_time_ns - stamp_ns
            for stamp_ns, log_time_ns in zip(self.stamps_ns, self.log_times_ns, strict=True)
        ]

    @property
    def usual_delay_ns(self) -> int:
        """Middle delay from stamp to log time, nanoseconds."""
        delays_ns = sorted(self._delays_ns())
        return delays_ns[len(delays_ns) // 2]


def sample_topics(
    index: LogIndex, candidates: Sequence[Topic], damage: list[Damage]
) -> dict[str, Sample]:
    """Read the earliest chunk with the candidates; more only where one of them is missing.

    Args:
        index: Index of the log.
        candidates: Topics of point clouds.
        damage: Chunks that cannot be read are added here.

    Returns:
        A sample for each topic of which a well-formed cloud was found, by topic.
    """
    samples: dict[str, Sample] = {}
    opened = ScannedChunks(index, candidates, damage)
    share_bytes = MAX_SAMPLE_BYTES // max(len(candidates), 1)
    for topic in candidates:
        found = EarliestClouds(topic.channel, share_bytes)
        for chunk in chunks_of(topic.channel, index.parts):
            # chunks may overlap: one that begins later may still have an earlier message
            if found.first_ns is not None and chunk.ref.start_ns >= found.first_ns:
                break
            found.add(opened.scan(chunk.ref))
        sample = _sample(topic, found)
        if sample.clouds:
            samples[topic.channel.topic] = sample
    return samples


def sample_end(index: LogIndex, sample: Sample) -> None:
    """Sample a topic's last chunk as well, since clocks may drift apart or jump."""
    chunks = chunks_of(sample.topic.channel, index.parts)
    last = max(chunks, key=lambda chunk: chunk.ref.end_ns)
    if last is not chunks[0]:
        _add_later(index, sample, last.ref)


def sample_middle(index: LogIndex, sample: Sample) -> None:
    """Sample a chunk from the middle of a topic, since its first clouds may be empty."""
    chunks = chunks_of(sample.topic.channel, index.parts)
    if len(chunks) > 1:
        _add_later(index, sample, chunks[len(chunks) // 2].ref)


def recorded_times(
    index: LogIndex, ref: ChunkRef, *, apart_ns: int, damage: list[Damage]
) -> list[tuple[int, int]]:
    """Open a chunk to read the log times of its messages.

    Args:
        index: Index of the log.
        ref: The chunk.
        apart_ns: Longest gap inside one stretch.
        damage: Unreadable chunks and impossible log times are added here.

    Returns:
        First and last log time of each stretch; none where that cannot be known.
    """
    key = index.readers[ref.part].key
    times_ns: list[int] = []
    impossible_ns: list[int] = []
    try:
        for message in messages_in(index.open(ref)):
            possible = message.log_time_ns <= MAX_TIME_NS
            (times_ns if possible else impossible_ns).append(message.log_time_ns)
    except (ChunkUnreadableError, RecordMalformedError) as error:
        damage.append(damaged_chunk(key, ref, error.problem))
    if impossible_ns and not times_ns:  # else its shard reads it, and reports them
        what = f"all its messages say that they were logged at {impossible_ns[0]} ns or the like"
        damage.append(damaged_chunk(key, ref, what))
    stretches: list[tuple[int, int]] = []
    for time_ns in sorted(times_ns):
        if stretches and time_ns - stretches[-1][1] <= apart_ns:
            stretches[-1] = (stretches[-1][0], time_ns)
        else:
            stretches.append((time_ns, time_ns))
    return stretches


def _add_later(index: LogIndex, sample: Sample, ref: ChunkRef) -> None:
    found = EarliestClouds(sample.topic.channel, MAX_SAMPLE_BYTES // 4)
    found.add(ScannedChunks(index, [sample.topic], []).scan(ref))
    later = _sample(sample.topic, found)
    sample.later_clouds += later.clouds
    sample.later_delays_ns += [
        log_time_ns - cloud.stamp_ns
        for cloud, log_time_ns in zip(later.clouds, later.log_times_ns, strict=True)
        if 0 < cloud.stamp_ns <= MAX_TIME_NS
    ]


def _sample(topic: Topic, found: EarliestClouds) -> Sample:
    sample = Sample(topic)
    previous_ns: int | None = None
    for log_time_ns, cloud in found.clouds:
        header_ns = cloud.stamp_ns if cloud.stamp_ns <= MAX_TIME_NS else 0
        previous_ns = frame_stamp_ns(
            header_ns, log_time_ns=log_time_ns, previous_stamp_ns=previous_ns
        )
        sample.clouds.append(cloud)
        sample.log_times_ns.append(log_time_ns)
        sample.stamps_ns.append(previous_ns)
    return sample
