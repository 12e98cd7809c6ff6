"""Shard reader: the frames of one shard in order, with the next chunks read ahead."""

import heapq
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, repeat
from typing import Final

from schemas.boxes import RecordedBoxes
from schemas.frame import LidarFrame, RecordedLabels, RecordedMotion
from schemas.mining import MiningSettings
from schemas.recorded_source import PredictionFiles
from schemas.transport.bucket import Bucket
from schemas.work import Channel, ChunkRef, RecordedSource, Recording, Shard
from workers.errors import CloudUnreadableError
from workers.ingest.boxes.reading import BoxReader
from workers.ingest.chunk import messages_in
from workers.ingest.damage import DamageList, damaged
from workers.ingest.decoding import MessageUnreadableError
from workers.ingest.fetch import OpenedChunk, fetch_chunks
from workers.ingest.frames import frame_from_cloud
from workers.ingest.global_fixes import FixLog
from workers.ingest.joining import Joiner
from workers.ingest.limits import MAX_WAITING, MAX_WAITING_BYTES
from workers.ingest.message_rate import MessageRate
from workers.ingest.messages import MAX_TIME_NS, RawMessage
from workers.ingest.part_reader import PartReader
from workers.ingest.pointcloud import DecodedCloud, decode_cloud
from workers.ingest.prediction_files import LabelFiles
from workers.ingest.recorded_labels import LabelPairing, recorded_labels
from workers.ingest.recorded_motion import MotionLog, middle_ns
from workers.ingest.recorded_source import spaces_of
from workers.ingest.records import RecordMalformedError
from workers.ingest.topics import ids_in

Answer = RecordedLabels | RecordedBoxes | None
"""Answer of the model on the car for one cloud; None without one."""

FRAMES_HELD: Final = 2
"""Frames that wait for the car's recorded motion, where a log has it."""


def read_shard(
    bucket: Bucket, recording: Recording, shard: Shard, settings: MiningSettings
) -> "ShardReader":
    """Prepare to read the frames of a shard; nothing is read before `frames` is iterated."""
    return ShardReader(recording, shard, settings, _part_readers(bucket, recording))


@dataclass(frozen=True, slots=True, eq=False)
class SourcedMessage:
    """A message with its chunk, which gives its place when it is damaged."""

    message: RawMessage
    ref: ChunkRef


@dataclass(slots=True, eq=False)
class ShardReader:
    """The frames of one shard, and after them the costs and damage of reading.

    Attributes:
        recording: Objects of the log.
        shard: Which window of it.
        settings: The meaning of stamps.
        readers: One for each part.
        damage: Stretches that could not be read.
    """

    recording: Recording
    shard: Shard
    settings: MiningSettings
    readers: tuple[PartReader, ...]
    damage: DamageList = field(default_factory=DamageList)
    _motion: MotionLog = field(default_factory=MotionLog)
    _motion_damaged: bool = False
    _fixes: FixLog = field(default_factory=FixLog)
    _sourced: SourcedMessage | None = None
    _joiner: Joiner | None = None

    @property
    def range_reads(self) -> int:
        """Requests so far."""
        return sum(reader.range_reads for reader in self.readers)

    @property
    def bytes_read(self) -> int:
        """Bytes read by these requests."""
        return sum(reader.bytes_read for reader in self.readers)

    def frames(self) -> Generator[LidarFrame, None, None]:
        """Yield the frames from warm-up to lookahead, in the order of their log times.

        Raises:
            ObjectChangedError: If an object is no longer the planned one.
            BucketUnreachableError: If the bucket does not answer.
        """
        timed = self._timed_frames()
        if self.shard.motion is not None:
            timed = self._with_motion(timed)
        if self.shard.further:
            self._joiner = Joiner(self.shard, self.settings, self._record_message)
            timed = self._joiner.joined(timed)
        for frame, _ in timed:
            if self._wants(frame.stamp_ns):
                yield frame
        for sentence in self._joiner.sentences() if self._joiner is not None else ():
            self._record(self.shard.chunks[0], sentence, length=0)
        if self.shard.fixes is not None and (what := self._fixes.sentence(self.shard.fixes.topic)):
            self._record(self.shard.chunks[0], what, length=0)

    def _timed_frames(self) -> Iterator[tuple[LidarFrame, int]]:
        """Yield all frames with their log times, those too early and too late included."""
        previous_ns: int | None = None
        for cloud, log_time_ns, answer in self._answered_clouds():
            no_stamp = self.shard.by_log_time or cloud.stamp_ns > MAX_TIME_NS
            frame = frame_from_cloud(
                replace(cloud, stamp_ns=0) if no_stamp else cloud,
                log_id=self.shard.log_id,
                log_time_ns=log_time_ns,
                previous_stamp_ns=previous_ns,
                intensity_scale=self.shard.intensity_scale,
                stamp_at=self.settings.stamp_at,
                compensated=self.settings.compensated,
                recorded=None if isinstance(answer, RecordedBoxes) else answer,
                camera=self.shard.camera,
            )
            previous_ns = frame.stamp_ns
            if isinstance(answer, RecordedBoxes):
                later_ns = frame.stamp_ns - (cloud.stamp_ns or log_time_ns)
                boxes = replace(answer, stamp_ns=answer.stamp_ns + later_ns)
                frame = replace(frame, boxes=boxes)
            if self.shard.fixes is not None:
                fixes = self._fixes.taken(delay_ns=log_time_ns - frame.stamp_ns)
                frame = replace(frame, fixes=fixes) if fixes else frame
            yield frame, log_time_ns

    def _with_motion(
        self, timed: Iterator[tuple[LidarFrame, int]]
    ) -> Iterator[tuple[LidarFrame, int]]:
        """Add the recorded motion since the frame before to each frame.

        A frame is held back for two more. The motion until the middle of its sweep is recorded
        after it, and at 10 Hz the first message after that comes after the next frame.
        """
        before: LidarFrame | None = None
        held: deque[tuple[LidarFrame, int]] = deque()
        for each in chain(timed, repeat(None, FRAMES_HELD)):
            if each is not None:
                held.append(each)
            if held and (each is None or len(held) > FRAMES_HELD):
                frame, log_time_ns = held.popleft()
                moved = None if before is None else self._moved(before, frame, log_time_ns)
                before = frame
                yield replace(frame, moved=moved), log_time_ns

    def _moved(
        self, before: LidarFrame, frame: LidarFrame, log_time_ns: int
    ) -> RecordedMotion | None:
        step_ns = frame.stamp_ns - before.stamp_ns
        return self._motion.between(
            middle_ns(before, step_ns=step_ns),
            middle_ns(frame, step_ns=step_ns),
            delay_ns=log_time_ns - frame.stamp_ns,
        )

    def _wants(self, stamp_ns: int) -> bool:
        shard = self.shard
        return (shard.first_of_log or stamp_ns >= shard.warmup_start_ns) and (
            shard.last_of_log or stamp_ns < max(shard.lookahead_end_ns, shard.end_ns)
        )

    def _answered_clouds(self) -> Iterator[tuple[DecodedCloud, int, Answer]]:
        """Yield the lidar's clouds with their log times and the answer of the model on the car."""
        source = self.shard.recorded
        if source is not None and source.boxes is not None:
            yield from self._boxed_clouds(source)
        elif source is not None and source.files is not None:
            yield from self._filed_clouds(source, source.files)
        else:
            yield from self._labelled_clouds()

    def _boxed_clouds(self, source: RecordedSource) -> Iterator[tuple[DecodedCloud, int, Answer]]:
        """Yield the clouds with the boxes whose stamp is nearest."""
        reader = BoxReader(self.shard, source, self.settings, record=self._record_message)
        rate = MessageRate(by_log_time=self.shard.by_log_time)
        try:
            for sourced in self._in_order():
                message = sourced.message
                self._sourced = sourced
                complete = reader.add(message)
                if message.channel is self.shard.motion:
                    self._add_motion(sourced)
                elif message.channel is self.shard.lidar:
                    cloud = self._cloud(sourced, rate)
                    if cloud is not None:
                        complete = reader.add_cloud(cloud, message.log_time_ns)
                for (paired, log_time_ns), boxes in complete:
                    yield paired, log_time_ns, boxes
            for (paired, log_time_ns), boxes in reader.rest():
                yield paired, log_time_ns, boxes
        finally:
            for sentence in reader.notices.sentences():
                self._record(self.shard.chunks[0], sentence, length=0)

    def _filed_clouds(
        self, source: RecordedSource, files: PredictionFiles
    ) -> Iterator[tuple[DecodedCloud, int, Answer]]:
        """Yield the clouds with the labels of their files."""
        reader = LabelFiles(self.settings.predictions, files, source.classes_json)
        rate = MessageRate(by_log_time=self.shard.by_log_time)
        number, missing = files.first_cloud - 1, 0
        for sourced in self._in_order():
            if sourced.message.channel is self.shard.motion:
                self._add_motion(sourced)
                continue
            number += 1
            cloud = self._cloud(sourced, rate)
            if cloud is None:
                continue
            labels = None
            try:
                labels = reader.labels(cloud, number)
                missing += labels is None and self._scores(cloud.stamp_ns)
            except CloudUnreadableError as error:
                if self._scores(cloud.stamp_ns):
                    self._record(sourced.ref, str(error), length=0)
            yield cloud, sourced.message.log_time_ns, labels
        if missing:
            self._record(self.shard.chunks[0], reader.missing(missing), length=0)

    def _labelled_clouds(self) -> Iterator[tuple[DecodedCloud, int, RecordedLabels | None]]:
        """Yield the lidar's clouds with their log times and, where the log has them, labels."""
        source = self.shard.recorded
        if source is None:
            for sourced, cloud in self._clouds():
                yield cloud, sourced.message.log_time_ns, None
            return
        pairing: LabelPairing[tuple[DecodedCloud, int]] = LabelPairing(source)
        for sourced, cloud in self._clouds():
            message = sourced.message
            try:
                if source.channel is None:
                    yield cloud, message.log_time_ns, recorded_labels(cloud, source)
                elif message.channel is source.channel:
                    for (paired, log_time_ns), labels in pairing.add_labels(cloud):
                        yield paired, log_time_ns, labels
                else:
                    for (paired, log_time_ns), labels in pairing.add_cloud(
                        cloud, (cloud, message.log_time_ns)
                    ):
                        yield paired, log_time_ns, labels
            except CloudUnreadableError as error:
                self._record(sourced.ref, str(error), length=len(message.data))
                if source.channel is None:
                    yield cloud, message.log_time_ns, None
        for (paired, log_time_ns), labels in pairing.rest():
            yield paired, log_time_ns, labels

    def _clouds(self) -> Iterator[tuple[SourcedMessage, DecodedCloud]]:
        rate = MessageRate(by_log_time=self.shard.by_log_time)
        for sourced in self._in_order():
            if sourced.message.channel is self.shard.motion:
                self._add_motion(sourced)
            elif (cloud := self._cloud(sourced, rate)) is not None:
                yield sourced, cloud

    def _cloud(self, sourced: SourcedMessage, rate: MessageRate) -> DecodedCloud | None:
        """Decode a cloud of the lidar or of its labels; None where it is unreadable."""
        message = sourced.message
        is_lidar = message.channel is self.shard.lidar
        try:
            if is_lidar:
                rate.check_logged(message)
            cloud = decode_cloud(message)
            if is_lidar:
                rate.check_taken(cloud, message)
        except CloudUnreadableError as error:
            self._record(sourced.ref, str(error), length=len(message.data))
            return None
        return cloud

    def _scores(self, stamp_ns: int) -> bool:
        return self.shard.start_ns <= stamp_ns < self.shard.end_ns

    def _add_motion(self, sourced: SourcedMessage) -> None:
        """Add a message of recorded motion; only the first unreadable one is recorded as damage."""
        try:
            self._motion.add(sourced.message)
        except MessageUnreadableError as error:
            if not self._motion_damaged:
                self._record(sourced.ref, str(error), length=len(sourced.message.data))
            self._motion_damaged = True

    def _in_order(self) -> Iterator[SourcedMessage]:
        """Yield messages by log time; fixes and further lidars of other topics are taken out."""
        fixes = self.shard.fixes
        joiner = self._joiner
        for sourced in self._by_time():
            channel = sourced.message.channel
            if joiner is not None and joiner.takes(channel):
                self._sourced = sourced
                joiner.add(sourced.message)
                continue
            if fixes is not None and channel.ids == fixes.ids:
                self._add_fix(sourced)
            if channel is not fixes:
                yield sourced

    def _add_fix(self, sourced: SourcedMessage) -> None:
        """Add a global fix; one that cannot be read is counted."""
        try:
            self._fixes.add(sourced.message)
        except MessageUnreadableError:
            self._fixes.ignored["unreadable"] += 1

    def _by_time(self) -> Iterator[SourcedMessage]:
        """Yield messages by log time: a chunk may have earlier ones than the chunk before it."""
        refs = self.shard.chunks
        waiting: list[tuple[int, int, SourcedMessage]] = []
        waiting_bytes, arrived = 0, 0
        for number, opened in enumerate(fetch_chunks(self.readers, refs)):
            for sourced in self._messages(opened):
                heapq.heappush(waiting, (sourced.message.log_time_ns, arrived, sourced))
                arrived += 1
                waiting_bytes += len(sourced.message.data)
                while waiting_bytes > MAX_WAITING_BYTES or len(waiting) > MAX_WAITING:
                    _, _, early = heapq.heappop(waiting)
                    waiting_bytes -= len(early.message.data)
                    yield early
            del opened  # its messages are copies: the chunk need not stay while they are used
            none_earlier_ns = refs[number + 1].start_ns if number + 1 < len(refs) else None
            while waiting and (none_earlier_ns is None or waiting[0][0] <= none_earlier_ns):
                _, _, early = heapq.heappop(waiting)
                waiting_bytes -= len(early.message.data)
                yield early

    def _messages(self, opened: OpenedChunk) -> Iterator[SourcedMessage]:
        if opened.error is not None:
            self._record(opened.ref, opened.error.problem)
            return
        channels = self._channels(opened.ref.part)
        try:
            for stored in messages_in(opened.records, channels.keys()):
                if stored.log_time_ns > MAX_TIME_NS:
                    what = f"a message says that it was logged at {stored.log_time_ns} ns"
                    self._record(opened.ref, what, length=len(stored.data))
                    continue
                channel = channels[stored.channel_id]
                # a copy, which decoding needs anyway: a view would keep the whole chunk
                message = RawMessage(channel, stored.log_time_ns, bytes(stored.data))
                yield SourcedMessage(message, opened.ref)
        except RecordMalformedError as error:
            self._record(opened.ref, error.problem)

    def _channels(self, part: int) -> dict[int, Channel]:
        """Return the channels of lidars, labels, motion and fixes by their ids in one part."""
        source = self.shard.recorded
        labels = source.channel if source is not None else None
        further = () if self._joiner is None else self._joiner.channels
        others = (*further, *spaces_of(source), self.shard.lidar, labels, self.shard.motion)
        wanted = (self.shard.fixes, *others)  # of one topic for both, the other reads it too
        channels = [channel for channel in wanted if channel is not None]
        return {each: channel for channel in channels for each in ids_in(channel, part)}

    def _record_message(self, what: str) -> None:
        """Record what is wrong with the message that is being read."""
        if self._sourced is not None:
            length = len(self._sourced.message.data)
            self._record(self._sourced.ref, what, length=length)

    def _record(self, ref: ChunkRef, what: str, *, length: int | None = None) -> None:
        self.damage.append(
            damaged(
                key=self.readers[ref.part].key,
                offset=ref.offset,
                length=ref.length if length is None else length,
                what=what,
            )
        )


def _part_readers(bucket: Bucket, recording: Recording) -> tuple[PartReader, ...]:
    return tuple(PartReader(bucket, part, number) for number, part in enumerate(recording.parts))
