"""Camera views: the images that belong to a frame, and their calibration, for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S, Transform
from schemas.errors import PermanentError
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.ingest.camera_calibration import NoViewError, calibrations_in, camera_from_lidar
from workers.ingest.camera_messages import (
    Calibration,
    CameraImage,
    camera_image,
    has_calibrations,
    has_images,
)
from workers.ingest.camera_model import CameraView
from workers.ingest.frames import sensor_points
from workers.ingest.images import IMAGE_ERRORS, image_size
from workers.ingest.log_index import LogIndex, index_recording
from workers.ingest.message_lookup import MessageLookup, readable
from workers.ingest.messages import RawMessage
from workers.ingest.part_reader import RecentReads
from workers.ingest.point_time import point_time
from workers.ingest.topic_sampling import Sample, sample_topics
from workers.ingest.topics import Topic, topics_of
from workers.ingest.transforms import has_transforms

MAX_APART_NS: Final = NS_PER_S // 2
"""Largest time between image and frame, nanoseconds; a later image shows another situation."""

_MOST_CHUNKS: Final = 8
"""Chunks whose images are kept for the next frame."""

_SWEEP_NS: Final = NS_PER_S // 10
"""Time of a sweep, within which the lidar sees what a camera sees."""

_MOST_SEARCHES: Final = 4
"""Frames around which the places of cameras are searched."""

VIEW_COS: Final = float(np.cos(np.deg2rad(30)))
"""Cosine of 30 degrees: returns within this angle of a camera's axis are in its view."""


class CameraUnavailableError(PermanentError):
    """The log has no calibrated camera that saw a frame."""


@dataclass(slots=True, eq=False)
class CameraReader:
    """Reader of the cameras of a log, frame by frame; the first frame opens the log.

    Place and calibration of a camera are those at the first frame that it saw.

    Attributes:
        bucket: Bucket of the log.
        recording: The log.
        lidar_topic: Topic of the frames' lidar.
        reach_ns: Time around the sweep over the cameras in which chunks are searched for images,
            once the cameras are placed.
        recent: Last reads of each part of the log by the reader of its clouds; empty: none.
    """

    bucket: Bucket
    recording: Recording
    lidar_topic: str
    reach_ns: int = MAX_APART_NS
    recent: Sequence[RecentReads] = ()
    _log: "_OpenedLog | None" = None
    _placed: "dict[str, _Placed]" = field(default_factory=dict)
    _searches: int = 0
    _chunks: dict[tuple[int, int], list[RawMessage]] = field(default_factory=dict)

    @property
    def range_reads(self) -> int:
        """Requests so far."""
        return self._log.index.range_reads if self._log else 0

    @property
    def bytes_read(self) -> int:
        """Bytes read by these requests."""
        return self._log.index.bytes_read if self._log else 0

    def views_at(self, stamp_ns: int) -> list[CameraView]:
        """Read the image of each calibrated camera that belongs to a frame.

        Of a camera's images the one nearest to the lidar's sweep over its view is taken, as far as
        points have times.

        Args:
            stamp_ns: Of the frame, nanoseconds since the Unix epoch.

        Returns:
            At least one view, by topic.

        Raises:
            CameraUnavailableError: If no camera with a known place saw the frame; it gives the
                reason.
            NotMcapError: If a part is no MCAP file.
            ObjectChangedError: If a part is no longer the listed one.
        """
        log = self._log = self._log or self._opened()
        lookup = self._lookup(log, stamp_ns)
        views: list[CameraView] = []
        problems: list[str] = []
        for topic in log.images:
            try:
                views.append(self._view(log, lookup, topic, stamp_ns))
            except NoViewError as error:
                problems.append(f"{topic.channel.topic} {error}")
        if not views:
            raise _unavailable("; ".join(problems), self.recording)
        return sorted(views, key=lambda view: view.topic)

    def _lookup(self, log: "_OpenedLog", stamp_ns: int) -> MessageLookup:
        """Look for images, and as long as cameras have no place also for calibrations."""
        logged_ns = stamp_ns + log.delay_ns
        is_placed = all(topic.channel.topic in self._placed for topic in log.images)
        if not is_placed and self._searches < _MOST_SEARCHES:
            self._searches += 1
            reach_ns = min(MAX_APART_NS, self.reach_ns + _SWEEP_NS)
            return MessageLookup(log.index, log.topics, logged_ns, reach_ns)
        for old in list(self._chunks)[:-_MOST_CHUNKS]:
            del self._chunks[old]
        swept_ns = [each.swept_after_ns for each in self._placed.values()] or [0]
        middle_ns = (min(swept_ns) + max(swept_ns)) // 2
        return MessageLookup(
            index=log.index,
            topics=log.images,
            log_time_ns=logged_ns + middle_ns,
            reach_ns=self.reach_ns + max(swept_ns) - middle_ns,
            opened=self._chunks,
        )

    def _opened(self) -> "_OpenedLog":
        index = index_recording(self.bucket, self.recording, recent=self.recent)
        topics = topics_of(index.parts)
        images = [topic for topic in topics if has_images(topic.channel) and topic.messages]
        lidar = [topic for topic in topics if topic.channel.topic == self.lidar_topic]
        sample = sample_topics(index, lidar, []).get(self.lidar_topic)
        if sample is None:
            raise _unavailable(f"no cloud of {self.lidar_topic} can be read", self.recording)
        if not images:
            why = "no topic holds compressed images (sensor_msgs or foxglove)"
            raise _unavailable(why, self.recording)
        wanted = [topic for topic in topics if _is_of_a_camera(topic)]
        return _OpenedLog(index, sample, images, wanted)

    def _view(
        self, log: "_OpenedLog", lookup: MessageLookup, topic: Topic, stamp_ns: int
    ) -> CameraView:
        images = readable(lookup.near(topic), camera_image)
        if not images:
            raise NoViewError("has no image that can be read near the frame")
        name = topic.channel.topic
        placed = self._placed.get(name) or _place(log, lookup, images[0])
        self._placed[name] = placed
        seen_ns = stamp_ns + placed.swept_after_ns
        image = min(images, key=lambda each: (abs(each.stamp_ns - seen_ns), each.stamp_ns))
        apart_ns = abs(image.stamp_ns - seen_ns)
        if apart_ns > MAX_APART_NS:
            raise NoViewError(f"has its nearest image {apart_ns / NS_PER_S:.1f} s from the frame")
        return _combine(image, placed.calibration, placed.camera_from_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class _OpenedLog:
    """Index of a log, first clouds of its lidar, and topics: images, and all of its cameras."""

    index: LogIndex
    sample: Sample
    images: Sequence[Topic]
    topics: Sequence[Topic]

    @property
    def delay_ns(self) -> int:
        return (self.sample.bounds.least_ns + self.sample.bounds.most_ns) // 2


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """Calibration and place of a camera, and the time from a frame to the sweep over its view."""

    calibration: Calibration
    camera_from_lidar: Transform
    swept_after_ns: int


def _place(log: _OpenedLog, lookup: MessageLookup, image: CameraImage) -> _Placed:
    found = _calibration_for(image, calibrations_in(lookup))
    if found is None:
        raise NoViewError("has no calibration")
    placed = camera_from_lidar(lookup, log.sample, found.frame_id or image.frame_id)
    return _Placed(found, placed, _swept_after_ns(log.sample, placed))


def _unavailable(why: str, recording: Recording) -> CameraUnavailableError:
    return CameraUnavailableError(f"no camera to show: {why} ({recording.log_id})")


def _is_of_a_camera(topic: Topic) -> bool:
    channel = topic.channel
    return has_images(channel) or has_calibrations(channel) or has_transforms(channel)


def _calibration_for(image: CameraImage, calibrations: Sequence[Calibration]) -> Calibration | None:
    """Select the calibration of the image's space; of several, the nearest by topic name."""
    same = [each for each in calibrations if each.frame_id == image.frame_id]
    same_folder = [each for each in calibrations if image.topic.startswith(_folder(each.topic))]
    return max(
        same or same_folder,
        key=lambda each: _shared_parts(each.topic, image.topic),
        default=None,
    )


def _folder(topic: str) -> str:
    """Return the prefix of one camera's topics; a topic at the root has none of its own."""
    folder = topic.rpartition("/")[0]
    return f"{folder}/" if folder else topic


def _shared_parts(one: str, other: str) -> int:
    pairs = zip(one.split("/"), other.split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _swept_after_ns(sample: Sample, camera_from_lidar: Transform) -> int:
    """Return the time from a frame's stamp to the sweep over a camera; 0 without point times."""
    cloud = sample.clouds[-1]
    times = point_time(
        cloud.fields, points=len(cloud), stamp_ns=sample.stamps_ns[-1], stamp_at="start"
    )
    if not times.recorded:
        return 0
    points_m, valid_mask = sensor_points(cloud)
    depth_m = points_m @ camera_from_lidar[2, :3]
    in_view_mask = valid_mask & (depth_m > VIEW_COS * np.linalg.norm(points_m, axis=1))
    return int(np.median(times.offset_ns[in_view_mask])) if in_view_mask.any() else 0


def _combine(image: CameraImage, found: Calibration, camera_from_lidar: Transform) -> CameraView:
    """Scale the calibration to the image; a rectified image needs no lens model."""
    width, height = _size(image)
    rectified = "rect" in image.topic.rpartition("/")[0] or "rect" in image.frame_id
    distorted = any(found.distortion) and not rectified
    projection = found.projection
    if distorted or not projection.any():
        projection = np.hstack((found.intrinsics, np.zeros((3, 1))))
    if not (projection[0, 0] and projection[1, 1]):
        raise NoViewError("has a calibration without focal lengths")
    scale = np.diag((width / (found.width or width), height / (found.height or height), 1.0))
    return CameraView(
        topic=image.topic,
        stamp_ns=image.stamp_ns,
        image_bytes=image.data,
        image_format=image.format,
        width=width,
        height=height,
        pixel_from_camera=scale @ projection,
        distortion_model=found.distortion_model,
        distortion=found.distortion if distorted else (),
        camera_from_lidar=camera_from_lidar,
    )


def _size(image: CameraImage) -> tuple[int, int]:
    try:
        return image_size(image.data)
    except IMAGE_ERRORS as error:
        raise NoViewError(f"has an image in format {image.format!r} that cannot be read") from error
