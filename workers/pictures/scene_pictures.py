"""Pictures of a scene: the camera images in which its reported tracks are strongest."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.errors import PermanentError
from schemas.overlay import Overlay
from schemas.overlay_picture import Picture
from schemas.score import SceneScore, shown_tracks
from schemas.sights import sights_of, tracks_seen
from schemas.transport.bucket import Bucket
from workers.ingest.camera import CameraReader
from workers.ingest.camera_model import CameraView
from workers.ingest.part_reader import RecentReads
from workers.ingest.read import ShardReader
from workers.pictures.compression import PictureUnreadableError, as_recorded, smaller

_MOST_TRIES: Final = 3
"""Frames of a scene, and scenes of a shard, in which a camera is searched in vain."""

_REACH_NS: Final = NS_PER_S * 6 // 100
"""Time around the sweep over a camera in which chunks are read: half a period of a 10 Hz camera."""

Size = Literal["all", "small", "none"]

MOST_PICTURES: Final[dict[Size, int]] = {"all": 128, "small": 8, "none": 0}
"""Pictures of a scene at most."""

MOST_FRAMES: Final[dict[Size, int]] = {"all": 64, "small": 4, "none": 0}
"""Frames of a scene at most whose images are read."""

MOST_BYTES: Final = 64 * 1024 * 1024
"""Bytes of the pictures of one scene at most."""


@dataclass(slots=True, eq=False)
class ScenePictures:
    """Chooser and reader of the pictures of a shard's scenes.

    Attributes:
        cameras: Reader of the log's cameras; None where it has none, or no pictures are kept.
        size: The setting `pictures`.
        pictures: Pictures kept so far.
        picture_bytes: Bytes of them.
    """

    cameras: CameraReader | None
    size: Size
    pictures: int = 0
    picture_bytes: int = 0
    _in_vain: int = 0

    @classmethod
    def of(cls, bucket: Bucket, shard_reader: ShardReader, *, size: Size) -> "ScenePictures":
        """Prepare for a shard; nothing is read before the first scene with a reported track.

        Images are mostly in the chunks of the clouds, so the last reads of these are kept.

        Args:
            bucket: Bucket of the log.
            shard_reader: Reader of the clouds, before it reads.
            size: The setting `pictures`.
        """
        shard = shard_reader.shard
        if size == "none" or not shard.has_cameras:
            return cls(None, size)
        recent = [RecentReads() for _ in shard_reader.readers]
        for reader, reads in zip(shard_reader.readers, recent, strict=True):
            reader.recent = reads
        cameras = CameraReader(
            *(bucket, shard_reader.recording),
            lidar_topic=shard.lidar.topic,
            reach_ns=_REACH_NS,
            recent=recent,
        )
        return cls(cameras, size)

    @property
    def range_reads(self) -> int:
        """Requests so far."""
        return self.cameras.range_reads if self.cameras else 0

    @property
    def bytes_read(self) -> int:
        """Bytes read by these requests."""
        return self.cameras.bytes_read if self.cameras else 0

    def of_scene(self, score: SceneScore, overlay: Overlay) -> tuple[Picture, ...]:
        """Return the pictures of a scene, by frame and topic.

        An image that cannot be read, decoded or placed costs that picture alone.

        Args:
            score: Record of the scene.
            overlay: Its overlay without pictures.

        Raises:
            TransientError: If the bucket cannot be read now.
            ObjectChangedError: If a part of the log is no longer the planned one.
        """
        is_hopeless = self._in_vain >= _MOST_TRIES  # no camera of the log can be placed
        if self.cameras is None or is_hopeless or not score.tracks:
            return ()
        kept: list[Picture] = []
        left_bytes = MOST_BYTES
        for picture in self._chosen(shown_tracks(score), overlay):
            left_bytes -= len(picture.image_bytes)
            if left_bytes < 0 or len(kept) == MOST_PICTURES[self.size]:
                break
            kept.append(picture)
        self.pictures += len(kept)
        self.picture_bytes += sum(len(picture.image_bytes) for picture in kept)
        return tuple(sorted(kept, key=lambda each: (each.frame, each.topic)))

    def _chosen(self, tracks: Sequence[TrackRecord], overlay: Overlay) -> Iterator[Picture]:
        """Yield pictures, those of the first track first."""
        read: dict[int, list[CameraView]] = {}
        known = self._first_views(tracks, overlay, read)
        for track in tracks if known else ():
            # the nearest frames to its strongest one in which a camera sees it
            frames = list(dict.fromkeys(s.frame for s in sights_of([track], overlay, known)))
            for frame in frames if self.size == "all" else frames[:1]:
                if frame not in read:
                    if len(read) == MOST_FRAMES[self.size]:
                        return
                    read[frame] = self._views_at(overlay, frame)
                views, read[frame] = read[frame], []  # each image is kept once
                for view in views:
                    picture = self._picture(view, tracks, overlay, frame)
                    if picture is not None:
                        yield picture

    def _first_views(
        self, tracks: Sequence[TrackRecord], overlay: Overlay, read: dict[int, list[CameraView]]
    ) -> list[CameraView]:
        """Return one image of each camera, whose place is then known; empty without cameras."""
        for track in tracks[:_MOST_TRIES]:
            at = int(overlay.stamps_ns.searchsorted(track.strongest.stamp_ns))
            frame = min(at, len(overlay) - 1)
            if frame not in read:
                read[frame] = self._views_at(overlay, frame)
            if read[frame]:
                self._in_vain = 0
                return read[frame]
        self._in_vain += 1
        return []

    def _views_at(self, overlay: Overlay, frame: int) -> list[CameraView]:
        if self.cameras is None:
            return []
        try:
            return self.cameras.views_at(int(overlay.stamps_ns[frame]))
        except PermanentError:
            return []

    def _picture(
        self, view: CameraView, tracks: Sequence[TrackRecord], overlay: Overlay, frame: int
    ) -> Picture | None:
        seen = tracks_seen(tracks, overlay, frame, view)
        if not seen:
            return None
        make = as_recorded if self.size == "all" else smaller
        try:
            return make(view, frame=frame, tracks=seen)
        except PictureUnreadableError:
            return None
