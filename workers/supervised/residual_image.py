"""Residual images: range differences of each frame to past frames, from a ring buffer."""

from collections import deque
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from schemas.frame import PosedFrame
from workers.lidar.range_image import RangeImage, SensorProfile, project
from workers.points.point_kernels import moved
from workers.points.se3 import inverse

MAX_AGES: Final = 16
"""Largest number of past frames per frame; published networks use eight."""

MAX_AGE_S: Final = 10.0
"""Largest age of a stored frame, seconds: a hundred frames at 10 Hz."""


@dataclass(frozen=True, slots=True)
class ResidualSettings:
    """Ages of the past frames, and the range gate.

    Attributes:
        ages_s: Age of each past frame, youngest first; one channel each.
        tolerance_s: Largest difference of a frame's age from the wanted one.
        min_range_m: Nearer returns have no residual: the own car.
        max_range_m: Farther returns have no residual: too sparse to compare.

    Raises:
        ValueError: If a number is outside its bounds.
    """

    ages_s: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    tolerance_s: float = 0.05
    min_range_m: float = 2.0
    max_range_m: float = 50.0

    def __post_init__(self) -> None:
        """Refuse settings that no network was trained with, or that would store too many frames."""
        if not 1 <= len(self.ages_s) <= MAX_AGES or not all(
            0 < age_s <= MAX_AGE_S for age_s in self.ages_s
        ):
            raise ValueError(
                f"residuals have 1 to {MAX_AGES} ages, each above 0 and up to {MAX_AGE_S:g} s"
            )
        if not (0 <= self.tolerance_s <= MAX_AGE_S and 0 <= self.min_range_m < self.max_range_m):
            raise ValueError("residuals need a tolerance_s, and min_range_m below max_range_m")


def residual_image(
    image: RangeImage, past_points_m: Points, profile: SensorProfile, settings: ResidualSettings
) -> NDArray[np.float32]:
    """Compare the current ranges with those that a past frame predicts.

    LiDAR-MOS: ``|range - past range| / range`` where both are inside the range gate, zero
    elsewhere. The past frame is projected in the form of the current one.

    Args:
        image: Projection of the current frame.
        past_points_m: (M, 3) points of the past frame in the current sensor space, metres.
        profile: Layout of both images.
        settings: The range gate.

    Returns:
        (H, W) float32, share of the current range; zero where nothing can be compared.
    """
    low, high = np.float32(settings.min_range_m), np.float32(settings.max_range_m)
    gate_m = (settings.min_range_m, settings.max_range_m)
    past = project(past_points_m, profile, gate_m=gate_m, form=image.form)
    current = image.range_m
    both = (current > low) & (current < high) & (past.range_m > 0)
    safe = np.where(both, current, np.float32(1))
    return np.where(both, np.abs(current - past.range_m) / safe, np.float32(0))


def with_residuals(
    image: RangeImage, channels: NDArray[np.float32], residuals: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Build LMNet's input: the channels of the frame, then its residuals in non-empty pixels.

    Args:
        image: Projection of the frame.
        channels: (5, H, W) result of `image_channels`.
        residuals: (K, H, W) one residual image per age; they are not normalised.

    Returns:
        (5 + K, H, W) float32.
    """
    return np.concatenate((channels, residuals * image.seen_mask))


class Past(Protocol):
    """Buffer of past frames for comparison with the current one."""

    def compare(self, posed: PosedFrame, image: RangeImage) -> tuple[NDArray[np.float32], int]:
        """Return the (K, H, W) residuals of a frame, and the number of them with a past frame."""
        ...


class ResidualHistory:
    """Buffer of the frames of the last second, for comparison with the next one.

    Frames are chosen by time, not by count. A sensor at 5 or 20 Hz and a log with dropped frames
    therefore give residuals like the training data. A jump back in time empties the buffer.
    """

    def __init__(self, profile: SensorProfile, settings: ResidualSettings) -> None:
        self._profile = profile
        self._settings = settings
        self._past: deque[tuple[int, Transform, Points]] = deque()

    def __len__(self) -> int:
        """Count the stored frames."""
        return len(self._past)

    def residuals(
        self, image: RangeImage, *, stamp_ns: int, odom_from_sensor: Transform
    ) -> tuple[NDArray[np.float32], int]:
        """Compare a frame with the past; call before `push`.

        Args:
            image: Projection of the current frame.
            stamp_ns: Its time, nanoseconds since the Unix epoch.
            odom_from_sensor: (4, 4) its pose.

        Returns:
            (K, H, W) float32, one residual image per age, zero where no frame is that old; and the
            number of ages with a frame.
        """
        settings = self._settings
        stack = np.zeros((len(settings.ages_s), *image.range_m.shape), dtype=np.float32)
        found = 0
        sensor_from_odom = inverse(odom_from_sensor)
        for channel, age_s in zip(stack, settings.ages_s, strict=True):
            past = self._at(stamp_ns - round(age_s * NS_PER_S))
            if past is None:
                continue
            odom_from_past, points_m = past
            placed_m = moved(points_m, sensor_from_odom @ odom_from_past)
            channel[:] = residual_image(image, placed_m, self._profile, settings)
            found += 1
        return stack, found

    def compare(self, posed: PosedFrame, image: RangeImage) -> tuple[NDArray[np.float32], int]:
        """Compare a frame with the past, then store it.

        Args:
            posed: The frame.
            image: Its projection.

        Returns:
            The result of `residuals`.
        """
        when = {"stamp_ns": posed.frame.stamp_ns}
        compared = self.residuals(image, **when, odom_from_sensor=posed.odom_from_sensor)
        visible = image.index[image.index >= 0]
        self.push(posed.frame.points_m[visible], **when, odom_from_sensor=posed.odom_from_sensor)
        return compared

    def push(self, points_m: Points, *, stamp_ns: int, odom_from_sensor: Transform) -> None:
        """Store a frame for later ones.

        Args:
            points_m: (M, 3) its points, own sensor space, metres; valid ones only.
            stamp_ns: Its time, nanoseconds since the Unix epoch.
            odom_from_sensor: (4, 4) its pose.
        """
        if self._past and stamp_ns <= self._past[-1][0]:
            self._past.clear()
        self._past.append((stamp_ns, odom_from_sensor, points_m))
        oldest_s = max(self._settings.ages_s, default=0.0) + self._settings.tolerance_s
        while stamp_ns - self._past[0][0] > oldest_s * NS_PER_S:
            self._past.popleft()

    def _at(self, wanted_ns: int) -> tuple[Transform, Points] | None:
        """Return the frame nearest to a time, if near enough; of equally near ones the older."""
        if not self._past:
            return None
        stamp_ns, pose, points_m = min(self._past, key=lambda past: abs(past[0] - wanted_ns))
        near = abs(stamp_ns - wanted_ns) <= self._settings.tolerance_s * NS_PER_S
        return (pose, points_m) if near else None
