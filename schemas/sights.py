"""Sights: the frames and cameras of a scene that see a track."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.contradiction import TrackRecord
from schemas.overlay import Overlay

_SIGNS: Final = np.array([[(c >> axis & 1) - 0.5 for axis in range(3)] for c in range(8)])
"""(8, 3) corners of a box of side 1 around the origin."""


class Projection(Protocol):
    """Projection of lidar points into one image."""

    @property
    def topic(self) -> str:
        """Topic of the camera's images."""
        ...

    def project(self, points_m: Points) -> tuple[NDArray[np.float64], Mask]:
        """Return (N, 2) pixels, and (N,) true where they are inside the image."""
        ...


@dataclass(frozen=True, slots=True)
class Sight:
    """A frame and a camera that see a track.

    Attributes:
        track_id: The track.
        frame: Index of the frame.
        topic: Topic of the camera's images.
    """

    track_id: int
    frame: int
    topic: str


def corners_m(box: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the (8, 3) corners of a box (centre, length, width, height, yaw), sensor space."""
    x, y, z, length, width, height, yaw = (float(value) for value in box)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    corners = (_SIGNS * (length, width, height)) @ turned.T + (x, y, z)
    return np.asarray(corners, dtype=np.float32)


def sights_of(
    tracks: Sequence[TrackRecord], overlay: Overlay, views: Sequence[Projection]
) -> Iterator[Sight]:
    """Yield frames and cameras that see the centre of tracks, the best ones first.

    The frames of the first track come first, by their distance in time to its strongest one; of
    several cameras first the one that sees most of its box.

    Args:
        tracks: Tracks of the scene's record, the first one first.
        overlay: Overlay of the scene.
        views: One image of each camera, whose projection is the same in all frames.
    """
    for track in tracks:
        mine = np.flatnonzero(overlay.instance_track == track.track_id)
        apart_ns = overlay.stamps_ns[overlay.instance_frame[mine]] - track.strongest.stamp_ns
        for instance in mine[np.argsort(np.abs(apart_ns), kind="stable")]:
            seen = [(_inside_mask(overlay, int(instance), view), view.topic) for view in views]
            seen.sort(key=lambda pair: (-int(pair[0].sum()), pair[1]))
            frame = int(overlay.instance_frame[instance])
            yield from (Sight(track.track_id, frame, topic) for inside, topic in seen if inside[0])


def tracks_seen(
    tracks: Sequence[TrackRecord], overlay: Overlay, frame: int, view: Projection
) -> tuple[int, ...]:
    """Return the numbers of the tracks whose centre an image of a frame sees."""
    wanted = {track.track_id for track in tracks}
    return tuple(
        sorted(
            {
                int(overlay.instance_track[instance])
                for instance in overlay.instances_of(frame)
                if int(overlay.instance_track[instance]) in wanted
                and _inside_mask(overlay, int(instance), view)[0]
            }
        )
    )


def _inside_mask(overlay: Overlay, instance: int, view: Projection) -> Mask:
    """Return (9,) true where the centre and the corners of an instance's box are in an image."""
    corners = corners_m(overlay.instance_boxes[instance])
    return view.project(np.concatenate([corners.mean(axis=0, keepdims=True), corners]))[1]
