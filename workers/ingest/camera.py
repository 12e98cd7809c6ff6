"""Camera views: the images that belong to a frame, and their calibration, for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
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
from workers.ingest.log_index import index_recording
from workers.ingest.message_lookup import MessageLookup, readable
from workers.ingest.point_time import point_time
from workers.ingest.topic_sampling import Sample, sample_topics
from workers.ingest.topics import Topic, topics_of
from workers.ingest.transforms import has_transforms

MAX_APART_NS: Final = NS_PER_S // 2
"""Largest time between image and frame, nanoseconds; a later image shows another situation."""

VIEW_COS: Final = float(np.cos(np.deg2rad(30)))
"""Cosine of 30 degrees: returns within this angle of a camera's axis are in its view."""


class CameraUnavailableError(PermanentError):
    """The log has no calibrated camera that saw a frame."""


def read_cameras(
    bucket: Bucket, recording: Recording, *, lidar_topic: str, stamp_ns: int
) -> list[CameraView]:
    """Read the image of each calibrated camera that belongs to a frame.

    Of a camera's images the one nearest to the lidar's sweep over its view is taken, as far as
    points have times.

    Args:
        bucket: Bucket of the log.
        recording: The log.
        lidar_topic: Topic of the frame's lidar.
        stamp_ns: Of the frame, nanoseconds since the Unix epoch.

    Returns:
        At least one view, by topic.

    Raises:
        CameraUnavailableError: If no camera with a known place saw the frame; it gives the reason.
        NotMcapError: If a part is no MCAP file.
        ObjectChangedError: If a part is no longer the listed one.
    """
    index = index_recording(bucket, recording)
    topics = topics_of(index.parts)
    images = [topic for topic in topics if has_images(topic.channel) and topic.messages]
    lidar = [topic for topic in topics if topic.channel.topic == lidar_topic]
    sample = sample_topics(index, lidar, []).get(lidar_topic)
    if sample is None:
        raise _unavailable(f"no cloud of {lidar_topic} can be read", recording)
    if not images:
        raise _unavailable("no topic holds compressed images (sensor_msgs or foxglove)", recording)
    wanted = [topic for topic in topics if _is_of_a_camera(topic)]
    delay_ns = (sample.bounds.least_ns + sample.bounds.most_ns) // 2
    lookup = MessageLookup(index, wanted, log_time_ns=stamp_ns + delay_ns, reach_ns=MAX_APART_NS)
    frame = _Frame(lookup, sample, stamp_ns, calibrations_in(lookup))
    views: list[CameraView] = []
    problems: list[str] = []
    for topic in images:
        try:
            views.append(_view(frame, topic))
        except NoViewError as error:
            problems.append(f"{topic.channel.topic} {error}")
    if not views:
        raise _unavailable("; ".join(problems), recording)
    return sorted(views, key=lambda view: view.topic)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """The frame to show, and the log's messages around it."""

    lookup: MessageLookup
    sample: Sample
    stamp_ns: int
    calibrations: Sequence[Calibration]


def _unavailable(why: str, recording: Recording) -> CameraUnavailableError:
    return CameraUnavailableError(f"no camera to show: {why} ({recording.log_id})")


def _is_of_a_camera(topic: Topic) -> bool:
    channel = topic.channel
    return has_images(channel) or has_calibrations(channel) or has_transforms(channel)


def _view(frame: _Frame, topic: Topic) -> CameraView:
    images = readable(frame.lookup.near(topic), camera_image)
    if not images:
        raise NoViewError("has no image that can be read near the frame")
    found = _calibration_for(images[0], frame.calibrations)
    if found is None:
        raise NoViewError("has no calibration")
    placed = camera_from_lidar(frame.lookup, frame.sample, found.frame_id or images[0].frame_id)
    seen_ns = frame.stamp_ns + _swept_after_ns(frame.sample, placed)
    image = min(images, key=lambda each: (abs(each.stamp_ns - seen_ns), each.stamp_ns))
    apart_ns = abs(image.stamp_ns - seen_ns)
    if apart_ns > MAX_APART_NS:
        raise NoViewError(f"has its nearest image {apart_ns / NS_PER_S:.1f} s from the frame")
    return _combine(image, found, placed)


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
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(BytesIO(image.data)) as opened:
            return opened.size
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise NoViewError(f"has an image in format {image.format!r} that cannot be read") from error
