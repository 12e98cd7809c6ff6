"""A map of KISS-ICP, begun at some frame: registers later frames in the space of that frame."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from workers.lidar.deskew import Twist, motion, twist
from workers.lidar.sensor_height import estimate_sensor_height
from workers.points.compiled import compiled
from workers.points.se3 import inverse

MAX_RANGE_M: Final = 100.0
VOXEL_M: Final = 1.0
_CONVERGED: Final = 1e-3
"""Convergence threshold of ICP, metres, where pose noise is centimetres.

A tenth of it takes twice the time."""

STEP_M: Final = 2.0
"""Error of the first step, metres, a third of the search radius: the default of KISS-ICP."""

_ROAD_M: Final = 0.3
_GOLDEN: Final = 0.6180339887498949
_ROAD_THINNING: Final = 20


class _Registered(NamedTuple):
    """A frame that is not in the map yet: pose, predicted pose, map points, time step."""

    pose: Transform
    guess: Transform
    places: NDArray[np.float64]
    dt_s: float


class KissMap:
    """A map of KISS-ICP (Vizzo et al., RA-L 2023) in one thread, without its deskewing.

    Its deskewing applies the previous motion, refers the pose to the end of the sweep and aborts
    the process when all stamps are equal. Without it the pose is that of the middle of the sweep,
    at any reference of the stamp.

    Attributes:
        pose: (4, 4) of the last frame, in the space of the first.
    """

    def __init__(self, velocity: Twist | None, *, step_m: float = STEP_M) -> None:
        """Begin a map.

        Args:
            velocity: Twist of the sensor per second; None if unknown.
            step_m: Largest error of the first step, metres.
        """
        self.pose: Transform = np.eye(4)
        self._velocity = velocity
        self._has_frames = False
        self._road_m = 0.0
        self._kiss = _new_kiss(step_m)
        self._registered: _Registered | None = None

    def expected(self, dt_s: float) -> Transform:
        """Predict the pose (4, 4) at constant velocity."""
        if not self._has_frames or self._velocity is None:
            return self.pose
        return self.pose @ motion(self._velocity * dt_s)

    def register(self, points: Points, dt_s: float) -> tuple[Transform | None, NDArray[np.float64]]:
        """Register a frame; the map does not change until `accept`.

        Args:
            points: (N, 3) returns of the frame, about the sensor.
            dt_s: Time since the frame before.

        Returns:
            (4, 4) its pose in the space of the first frame, None if registration failed; and
            (K, 3) its key points, about the sensor.
        """
        if not self._has_frames:
            self._road_m = _ROAD_M - estimate_sensor_height(points.astype(np.float64))
        kiss, guess = self._kiss, self.expected(dt_s)
        places, keypoints = _voxelised(kiss, subsample(points, self._road_m))
        sigma = kiss.adaptive_threshold.get_threshold()
        pose: Transform = kiss.registration.align_points_to_map(
            points=keypoints,
            voxel_map=kiss.local_map,
            initial_guess=guess,
            max_correspondance_distance=3 * sigma,
            kernel=sigma,
        )
        self._registered = _Registered(pose, guess, places, dt_s) if _is_pose(pose) else None
        return (None if self._registered is None else pose), keypoints

    def accept(self) -> None:
        """Accept the last registration, and add its points to the map."""
        if self._registered is None:
            return
        pose, guess, places, dt_s = self._registered
        self._registered = None
        self._kiss.adaptive_threshold.update_model_deviation(inverse(guess) @ pose)
        self._kiss.local_map.update(places, pose)
        if self._has_frames:
            self._velocity = twist(inverse(self.pose) @ pose) / dt_s
        self._has_frames, self.pose = True, pose

    def continue_from(self, pose: Transform) -> None:
        """Continue from a pose that no registration found."""
        self.pose = pose


def subsample(points: Points, road_m: float) -> NDArray[np.float64]:
    """Select half of the points, mixed, and of those on the road one in twenty of that.

    KISS-ICP keeps the first point of each voxel. In scan order that is always the same corner of
    the voxel, and the rings on the road are the same at any place of the car. Both bias the pose
    towards no motion: a car that sets off was followed at half its speed for a second. A few points
    of the road still constrain height, pitch and roll. Steps of the golden ratio spread evenly and
    need no random numbers.
    """
    n = len(points)
    step = int(n * _GOLDEN)
    while math.gcd(step, n) != 1:
        step += 1
    return _mixed(points, step, road_m)


@compiled
def _mixed(points: Points, step: int, road_m: float) -> NDArray[np.float64]:
    """Return every `step`-th point until half are taken, with few of those on the road; (M, 3)."""
    n = len(points)
    taken = np.empty((n // 2, 3), np.float64)
    count, on_road, i = 0, 0, 0
    for _ in range(n // 2):
        keep = points[i, 2] > road_m
        if not keep:
            keep = on_road % _ROAD_THINNING == 0
            on_road += 1
        if keep:
            for axis in range(3):
                taken[count, axis] = points[i, axis]
            count += 1
        i += step
        i -= n if i >= n else 0
    return taken[:count]


def _new_kiss(step_m: float) -> Any:
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.max_range = MAX_RANGE_M
    config.data.min_range = 0.0
    config.data.deskew = False
    config.mapping.voxel_size = VOXEL_M
    config.adaptive_threshold.initial_threshold = step_m
    config.registration.max_num_threads = 1
    config.registration.convergence_criterion = _CONVERGED
    return KissICP(config)


def _voxelised(kiss: Any, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the points that KISS-ICP adds to its map, and its fewer key points."""
    keypoints, places = kiss.voxelize(kiss.preprocessor.preprocess(points, np.empty(0), np.eye(4)))
    return places, keypoints


def _is_pose(pose: Transform) -> bool:
    return bool(
        np.isfinite(pose).all() and np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-3)
    )
