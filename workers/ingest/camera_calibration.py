"""Camera calibration: pose and projection of a log's cameras, for the camera filter."""

from collections.abc import Sequence

import numpy as np

from schemas.arrays import NS_PER_S, Transform
from schemas.camera import CameraCalibration
from workers.errors import LogUnusableError
from workers.ingest.camera_messages import Calibration, calibration, has_calibrations
from workers.ingest.log_index import LogIndex
from workers.ingest.message_lookup import MessageLookup, readable
from workers.ingest.topic_sampling import Sample
from workers.ingest.topics import Topic
from workers.ingest.transforms import (
    TransformTree,
    has_transforms,
    is_static,
    stated_transforms,
)


class NoViewError(Exception):
    """One camera cannot show the lidar's points; another may."""


def find_calibration(index: LogIndex, topics: Sequence[Topic], sample: Sample) -> CameraCalibration:
    """Find the calibration of the camera that looks most ahead.

    Args:
        index: Of the log.
        topics: Of the log.
        sample: First clouds of the lidar.

    Raises:
        LogUnusableError: If no camera has a calibration and a known place; it gives the reason.
    """
    wanted = [
        topic
        for topic in topics
        if has_calibrations(topic.channel) or has_transforms(topic.channel)
    ]
    delay_ns = (sample.bounds.least_ns + sample.bounds.most_ns) // 2
    logged_ns = sample.first_stamp_ns + delay_ns
    lookup = MessageLookup(index, wanted, log_time_ns=logged_ns, reach_ns=NS_PER_S)
    found: list[CameraCalibration] = []
    problems: list[str] = []
    for stated in calibrations_in(lookup):
        try:
            found.append(_combined(stated, camera_from_lidar(lookup, sample, stated.frame_id)))
        except NoViewError as error:
            problems.append(f"{stated.topic} {error}")
    if not found:
        why = "; ".join(problems) or "no topic holds a calibration (sensor_msgs or foxglove)"
        raise LogUnusableError(
            f"no camera for the camera filter: {why}; state one with the setting camera"
        )
    return max(found, key=lambda each: float(each.extrinsics[2, 0]))


def calibrations_in(lookup: MessageLookup) -> list[Calibration]:
    """Return one calibration of each topic, the nearest that can be read."""
    return [
        found
        for topic in lookup.topics
        if has_calibrations(topic.channel)
        for found in readable(lookup.near(topic), calibration)[:1]
    ]


def camera_from_lidar(lookup: MessageLookup, sample: Sample, camera: str) -> Transform:
    """Chain the log's transforms: static ones first, then those published around the moment.

    Args:
        lookup: Messages of the transform topics.
        sample: Of the lidar.
        camera: Space of the camera, by the log's own name.

    Returns:
        (4, 4) sensor space of the lidar to the camera's.

    Raises:
        NoViewError: If the log does not connect the two.
    """
    cloud = sample.clouds[0]
    tree = TransformTree()
    topics = [topic for topic in lookup.topics if has_transforms(topic.channel)]
    for topic in sorted(topics, key=lambda topic: not is_static(topic.channel)):
        static = is_static(topic.channel)
        messages = lookup.all(topic) if static else lookup.near(topic)
        for stated in readable(messages, stated_transforms):
            tree.add_stated(stated)
        camera_from_space = tree.find(to=camera, source=cloud.frame_id)
        if camera_from_space is not None:
            origin = cloud.space_from_points
            return camera_from_space if origin is None else camera_from_space @ origin
    raise NoViewError(
        f"is not tied to the lidar: no transform from {cloud.frame_id!r} to {camera!r}"
    )


def _combined(stated: Calibration, placed: Transform) -> CameraCalibration:
    projection = stated.projection
    if not projection.any():
        projection = np.hstack((stated.intrinsics, np.zeros((3, 1))))
    if not (projection[0, 0] and projection[1, 1]):
        raise NoViewError("has a calibration without focal lengths")
    if not (stated.width > 0 and stated.height > 0):
        raise NoViewError("does not say how large its images are")
    try:
        return CameraCalibration.of(projection, placed, width=stated.width, height=stated.height)
    except (ValueError, OverflowError) as error:
        raise NoViewError("has a calibration with numbers that no camera has") from error
