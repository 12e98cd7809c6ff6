"""Motion of recorded boxes: the velocity that the model states, else the path of a track."""

from collections import deque
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Transform
from schemas.boxes import RecordedBoxes
from schemas.labels import MotionLabel

MOVING_M_PER_S: Final = 0.8
"""Speed from which a box moves: a slow walk."""

STANDING_M_PER_S: Final = 0.5
"""Speed up to which a box stands; between both its motion is unknown."""

CENTRE_NOISE_M: Final = 0.15
"""Usual error of a detector's centre, one standard deviation, metres."""

WINDOW_NS: Final = NS_PER_S
"""Length of a track's path whose speed counts, nanoseconds."""

MIN_SAMPLES: Final = 3

FORGOTTEN_NS: Final = 2 * NS_PER_S
"""Time after which a track that is not seen is forgotten, nanoseconds."""

_Path = deque[tuple[int, NDArray[np.float64]]]


class BoxMotion:
    """Motion labels of boxes, frame by frame; tracks are followed in odom space by their ids."""

    def __init__(self) -> None:
        self._paths: dict[str, _Path] = {}

    def labels(
        self, boxes: RecordedBoxes, odom_from_sensor: Transform
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Label the boxes of one answer.

        Args:
            boxes: The answer.
            odom_from_sensor: Pose of the sensor at its time.

        Returns:
            (B,) values of `MotionLabel`, and (B, 3) velocities over the ground along the sensor's
            axes, metres per second, zero where unknown.
        """
        labels = np.full(len(boxes), MotionLabel.UNKNOWN, np.uint8)
        velocity = np.zeros((len(boxes), 3))
        odom_m = boxes.centre_m @ odom_from_sensor[:3, :3].T + odom_from_sensor[:3, 3]
        for index, (of_path, noise) in enumerate(self._path_velocities(boxes, odom_m)):
            stated = boxes.velocity_m_per_s[index]
            if np.isfinite(stated).all():
                velocity[index] = stated
                labels[index] = _label(float(np.hypot(*stated[:2])), 0.0)
            elif of_path is not None:
                velocity[index] = of_path @ odom_from_sensor[:3, :3]
                labels[index] = _label(float(np.hypot(*of_path[:2])), noise)
            elif boxes.movable[index] is False:
                labels[index] = MotionLabel.STATIC
            if boxes.moving[index]:
                labels[index] = MotionLabel.DYNAMIC
        return labels, velocity

    def _path_velocities(
        self, boxes: RecordedBoxes, odom_m: NDArray[np.float64]
    ) -> Iterator[tuple[NDArray[np.float64] | None, float]]:
        """Yield the velocity of each box by its path, or None, and its standard deviation."""
        for track_id in [
            track_id
            for track_id, path in self._paths.items()
            if boxes.stamp_ns - path[-1][0] > FORGOTTEN_NS or boxes.stamp_ns < path[-1][0]
        ]:
            del self._paths[track_id]
        for index, track_id in enumerate(boxes.track_id):
            if not track_id:
                yield None, 0.0
                continue
            path = self._paths.setdefault(track_id, deque())
            if not path or boxes.stamp_ns > path[-1][0]:
                path.append((boxes.stamp_ns, odom_m[index]))
            while path[-1][0] - path[0][0] > WINDOW_NS:
                path.popleft()
            yield _velocity_of(path)


def _velocity_of(path: _Path) -> tuple[NDArray[np.float64] | None, float]:
    """Fit a velocity to a path, and return its standard deviation too."""
    if len(path) < MIN_SAMPLES:
        return None, 0.0
    time_s = np.array([(stamp_ns - path[0][0]) / NS_PER_S for stamp_ns, _ in path])
    places = np.stack([place for _, place in path])
    apart = time_s - time_s.mean()
    spread = float(apart @ apart)
    velocity: NDArray[np.float64] = apart @ (places - places.mean(axis=0)) / spread
    return velocity, CENTRE_NOISE_M / float(np.sqrt(spread))


def _label(speed: float, noise: float) -> MotionLabel:
    """Label a speed, by two standard deviations of its error where it comes from a path."""
    if speed > max(MOVING_M_PER_S, STANDING_M_PER_S + 2.0 * noise):
        return MotionLabel.DYNAMIC
    if speed < STANDING_M_PER_S and noise < STANDING_M_PER_S:
        return MotionLabel.STATIC
    return MotionLabel.UNKNOWN
