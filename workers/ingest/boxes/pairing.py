"""Pairing of clouds with the answers of a model that answers in boxes, by the nearest stamp."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.boxes import RecordedBoxes
from workers.ingest.boxes.class_meanings import ClassMeanings
from workers.ingest.boxes.notices import BoxNotices
from workers.ingest.boxes.spaces import Spaces
from workers.ingest.boxes.stated import StatedBoxes
from workers.ingest.limits import MAX_WAITING_POINTS
from workers.ingest.pointcloud import DecodedCloud

MAX_WAITING: Final = 10
"""Clouds held back for their boxes: a second at 10 Hz, longer than a model on a car may take."""

FIRST_STEP_NS: Final = NS_PER_S // 10
"""Step between frames until one is known, nanoseconds."""

SAME_NS: Final = 1_000_000
"""Difference of stamps up to which boxes are of the cloud itself, nanoseconds."""

MAX_ANSWERS: Final = 64
"""Answers that are kept; at 10 Hz they last longer than clouds wait."""

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting(Generic[Item]):
    stamp_ns: int
    frame_id: str
    points: int
    item: Item


class BoxPairing(Generic[Item]):
    """Pairs clouds with boxes whose stamp is nearest, within half a frame.

    Boxes may come before their cloud or, since a model takes time, after it. A cloud leaves when a
    later answer cannot be nearer, or when ten more wait. A cloud without an answer has
    no boxes and is not judged. An answer without boxes labels every point as static.

    Args:
        spaces: Poses of the log's spaces.
        meanings: What the names of classes mean.
        notices: What is wrong with boxes is counted here.
    """

    def __init__(self, spaces: Spaces, meanings: ClassMeanings, notices: BoxNotices) -> None:
        self._spaces = spaces
        self._meanings = meanings
        self._notices = notices
        self._waiting: deque[_Waiting[Item]] = deque()
        self._answers: list[tuple[int, StatedBoxes]] = []
        self._used: set[int] = set()
        self._step_ns = FIRST_STEP_NS
        self._last_ns: int | None = None

    def add_cloud(
        self, cloud: DecodedCloud, stamp_ns: int, item: Item
    ) -> Iterator[tuple[Item, RecordedBoxes | None]]:
        """Add a cloud of the lidar and yield the complete ones; `item` is passed through."""
        if self._last_ns is not None and 0 < stamp_ns - self._last_ns < NS_PER_S:
            self._step_ns = stamp_ns - self._last_ns
        self._last_ns = stamp_ns
        self._waiting.append(_Waiting(stamp_ns, cloud.frame_id, len(cloud), item))
        yield from self._complete()

    def add_boxes(
        self, boxes: StatedBoxes, stamp_ns: int
    ) -> Iterator[tuple[Item, RecordedBoxes | None]]:
        """Add an answer and yield the complete clouds."""
        self._answers.append((stamp_ns, boxes))
        if len(self._answers) > MAX_ANSWERS:
            self._forget(self._answers.pop(0)[0])
        yield from self._complete()

    def rest(self) -> Iterator[tuple[Item, RecordedBoxes | None]]:
        """Yield the clouds that still wait, once no more messages come."""
        while self._waiting:
            yield self._leave()
        for stamp_ns, _ in self._answers:
            self._forget(stamp_ns)

    def _complete(self) -> Iterator[tuple[Item, RecordedBoxes | None]]:
        while self._waiting:
            first = self._waiting[0]
            few = sum(each.points for each in self._waiting) <= MAX_WAITING_POINTS
            decided = any(
                abs(stamp_ns - first.stamp_ns) <= SAME_NS
                or stamp_ns > first.stamp_ns + self._step_ns // 2
                for stamp_ns, _ in self._answers
            )
            if not decided and few and len(self._waiting) <= MAX_WAITING:
                return
            yield self._leave()

    def _leave(self) -> tuple[Item, RecordedBoxes | None]:
        cloud = self._waiting.popleft()
        near = min(
            self._answers, key=lambda each: abs(each[0] - cloud.stamp_ns), default=(None, None)
        )
        stamp_ns, boxes = near
        if stamp_ns is None or boxes is None or self._too_far(stamp_ns, cloud.stamp_ns):
            self._notices.without_answer(cloud.stamp_ns)
            return cloud.item, None
        self._used.add(stamp_ns)
        same = abs(stamp_ns - cloud.stamp_ns) <= SAME_NS
        at_ns = cloud.stamp_ns if same else stamp_ns
        return cloud.item, self._placed(boxes, cloud.frame_id, at_ns)

    def _too_far(self, stamp_ns: int, cloud_ns: int) -> bool:
        return abs(stamp_ns - cloud_ns) > self._step_ns // 2 + SAME_NS

    def _forget(self, stamp_ns: int) -> None:
        if stamp_ns not in self._used:
            self._notices.without_cloud(stamp_ns)
        self._used.discard(stamp_ns)

    def _placed(self, boxes: StatedBoxes, frame_id: str, stamp_ns: int) -> RecordedBoxes | None:
        sensor_from_boxes = np.eye(4)
        if boxes.frame_id and boxes.frame_id != frame_id.strip("/"):
            found = self._spaces.find(to=frame_id, source=boxes.frame_id, time_ns=stamp_ns)
            if found is None:
                known = self._spaces.knows(boxes.frame_id)
                self._notices.not_placed(boxes.frame_id, frame_id, known=known)
                return None
            sensor_from_boxes = found
        self._notices.boxes_read(boxes)
        place: NDArray[np.float64] = sensor_from_boxes @ boxes.place
        meanings = [self._meanings.of(name) for name in boxes.class_name]
        for name, meaning in zip(boxes.class_name, meanings, strict=True):
            if meaning.movable is None and name:
                self._notices.unmapped(name)
        return RecordedBoxes(
            stamp_ns=stamp_ns,
            centre_m=np.ascontiguousarray(place[:, :3, 3]),
            size_m=boxes.size_m.copy(),
            sensor_from_box=np.ascontiguousarray(place[:, :3, :3]),
            velocity_m_per_s=boxes.velocity_m_per_s @ sensor_from_boxes[:3, :3].T,
            score=boxes.score.copy(),
            class_name=tuple(meaning.name for meaning in meanings),
            track_id=boxes.track_id,
            movable=tuple(meaning.movable for meaning in meanings),
            moving=tuple(meaning.moving for meaning in meanings),
        )
