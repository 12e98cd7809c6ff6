"""Clouds of the further lidars of a joined scene, read from the log again."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from schemas.errors import PermanentError
from schemas.frame import LidarFrame
from schemas.overlay import Overlay
from schemas.work import FurtherLidar
from workers.errors import CloudUnreadableError
from workers.ingest.frames import frame_from_cloud, intensity_scale_of
from workers.ingest.joining import joined_frame
from workers.ingest.log_index import LogIndex
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import decode_cloud
from workers.ingest.topic_sampling import sample_topics
from workers.ingest.topics import Topic

PERIOD_NS: Final = 0
"""No cloud is searched for here: the overlay names the stamp of each."""


class FramesMissingError(PermanentError):
    """The log in the bucket does not contain the frames of a scene."""


class FurtherClouds:
    """Clouds of further lidars by the stamps that an overlay names.

    Args:
        index: Of the log.
        topics: All of the log.
        overlay: Overlay of the scene.

    Raises:
        FramesMissingError: If the log has no cloud of one of the lidars.
    """

    def __init__(self, index: LogIndex, topics: Sequence[Topic], overlay: Overlay) -> None:
        self._log_id, self._overlay = index.recording.log_id, overlay
        named = {each.topic for each in overlay.lidars}
        by_name = {each.channel.topic: each for each in topics if each.channel.topic in named}
        samples = sample_topics(index, list(by_name.values()), []) if by_name else {}
        if missing := named - samples.keys():
            raise FramesMissingError(
                f"the log {self._log_id} has no cloud of {min(missing)} that can be read: the "
                "scene was mined from another file of this name"
            )
        self._topics = by_name
        self._scales = {
            name: intensity_scale_of([*each.clouds, *each.later_clouds])
            for name, each in samples.items()
        }
        self._wanted = {
            (lidar.topic, stamp_ns)
            for lidar in overlay.lidars
            for stamp_ns in lidar.stamps_ns.tolist()
        }
        self._frames: dict[tuple[str, int], LidarFrame] = {}

    @property
    def topics(self) -> list[Topic]:
        """Topics of their clouds."""
        return list(self._topics.values())

    def read(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Keep the clouds of the scene among messages of topic, log time and payload."""
        for topic, log_time_ns, data in messages:
            try:
                cloud = decode_cloud(RawMessage(self._topics[topic].channel, log_time_ns, data))
            except CloudUnreadableError:
                continue
            known = (topic, cloud.stamp_ns) in self._wanted
            stamp_ns = cloud.stamp_ns if known else log_time_ns
            if (topic, stamp_ns) in self._wanted:
                self._frames[topic, stamp_ns] = frame_from_cloud(
                    replace(cloud, stamp_ns=stamp_ns),
                    log_id=self._log_id,
                    log_time_ns=log_time_ns,
                    previous_stamp_ns=None,
                    intensity_scale=self._scales[topic],
                    stamp_at="start",
                )

    def joined(self, frame: LidarFrame, number: int) -> LidarFrame:
        """Append the points of further lidars to a frame of the main one, in the order of mining.

        Raises:
            FramesMissingError: If the log no longer has one of the clouds.
        """
        if not self._overlay.lidars:
            return frame
        pairs: list[tuple[FurtherLidar, LidarFrame | None]] = []
        for lidar in self._overlay.lidars:
            stamp_ns, points = int(lidar.stamps_ns[number]), int(lidar.points[number])
            cloud = self._frames.get((lidar.topic, stamp_ns)) if points else None
            if (0 if cloud is None else len(cloud)) != points:
                raise FramesMissingError(
                    f"the cloud of {lidar.topic} of {stamp_ns} ns no longer has the {points} "
                    f"points of the overlay: the log was replaced, or is damaged there "
                    f"({self._log_id})"
                )
            planned = FurtherLidar(
                channel=self._topics[lidar.topic].channel,
                main_from_lidar=tuple(lidar.main_from_lidar[number].ravel().tolist()),
                period_ns=PERIOD_NS,
                intensity_scale=self._scales[lidar.topic],
            )
            pairs.append((planned, cloud))
        return joined_frame(frame, pairs)
