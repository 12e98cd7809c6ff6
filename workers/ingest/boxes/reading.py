"""Reading of boxes in a shard: messages of boxes and transforms in, answers for clouds out."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Final

from schemas.boxes import RecordedBoxes
from schemas.mining import MiningSettings
from schemas.work import BoxSource, RecordedSource, Shard
from workers.ingest.boxes.class_meanings import ClassMeanings
from workers.ingest.boxes.notices import BoxNotices
from workers.ingest.boxes.pairing import BoxPairing
from workers.ingest.boxes.parquet import AROUND_NS, read_box_file
from workers.ingest.boxes.spaces import Spaces
from workers.ingest.boxes.stated import StatedBoxes, stated_boxes
from workers.ingest.decoding import MessageUnreadableError
from workers.ingest.messages import MAX_TIME_NS, RawMessage
from workers.ingest.pointcloud import DecodedCloud
from workers.ingest.prediction_files import open_predictions
from workers.ingest.recorded_labels import recorded_classes

MAX_REPORTED: Final = 3
"""Unreadable messages of one topic that a shard names one by one."""

Complete = Iterator[tuple[tuple[DecodedCloud, int], RecordedBoxes | None]]
"""Clouds with their log times, and the boxes of each; None without an answer."""


class BoxReader:
    """Boxes of one shard.

    Args:
        shard: The shard.
        source: Its source, which has boxes.
        settings: The folder of predictions, for boxes in a file.
        record: Called with the reason why the message last added cannot be read.
    """

    def __init__(
        self,
        shard: Shard,
        source: RecordedSource,
        settings: MiningSettings,
        *,
        record: Callable[[str], None],
    ) -> None:
        boxes = source.boxes or BoxSource()
        self._source = boxes
        self._record = record
        self._reported: Counter[str] = Counter()
        self._spaces = Spaces(boxes.static_spaces)
        channel, files = boxes.channel, source.files
        topic = channel.topic if channel else files.key if files else ""
        self.notices = BoxNotices(
            topic,
            start_ns=0 if shard.first_of_log else shard.start_ns,
            end_ns=MAX_TIME_NS if shard.last_of_log else shard.end_ns,
        )
        self._pairing: BoxPairing[tuple[DecodedCloud, int]] = BoxPairing(
            self._spaces, ClassMeanings(recorded_classes(source.classes_json)), self.notices
        )
        self._of_file: deque[StatedBoxes] = deque()
        if files is not None:
            self._of_file.extend(
                read_box_file(
                    open_predictions(settings.predictions),
                    files.key,
                    start_ns=0 if shard.first_of_log else shard.warmup_start_ns - AROUND_NS,
                    end_ns=MAX_TIME_NS if shard.last_of_log else _end_ns(shard) + AROUND_NS,
                    clouds_ns=(shard.warmup_start_ns - AROUND_NS, _end_ns(shard) + AROUND_NS),
                )
            )

    def add(self, message: RawMessage) -> Complete:
        """Add a message of boxes, of transforms or of poses; any other is ignored.

        Yields:
            The clouds that it completes.
        """
        if any(message.channel.ids == each.ids for each in self._source.moving_spaces):
            try:
                self._spaces.add(message)
            except MessageUnreadableError as error:
                self._report(message, str(error))
        elif self._source.channel is not None and message.channel is self._source.channel:
            try:
                boxes = stated_boxes(message)
            except MessageUnreadableError as error:
                self._report(message, str(error))
            else:
                stamp_ns = boxes.stamp_ns or message.log_time_ns
                yield from self._pairing.add_boxes(boxes, stamp_ns)

    def add_cloud(self, cloud: DecodedCloud, log_time_ns: int) -> Complete:
        """Add a cloud of the lidar and yield the complete ones."""
        stamp_ns = cloud.stamp_ns or log_time_ns
        while self._of_file and self._of_file[0].stamp_ns <= stamp_ns + AROUND_NS:
            boxes = self._of_file.popleft()
            yield from self._pairing.add_boxes(boxes, boxes.stamp_ns)
        yield from self._pairing.add_cloud(cloud, stamp_ns, (cloud, log_time_ns))

    def rest(self) -> Complete:
        """Yield the clouds that still wait."""
        yield from self._pairing.rest()
        for boxes in self._of_file:
            self.notices.without_cloud(boxes.stamp_ns)

    def _report(self, message: RawMessage, what: str) -> None:
        topic = message.channel.topic
        self._reported[topic] += 1
        if self._reported[topic] <= MAX_REPORTED:
            self._record(what)


def _end_ns(shard: Shard) -> int:
    return max(shard.lookahead_end_ns, shard.end_ns)
