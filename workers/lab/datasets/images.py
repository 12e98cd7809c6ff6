"""Training images of frames with truth: range images, labels, residual images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import NS_PER_S, Points, Transform
from schemas.frame import LidarFrame
from workers.lidar.range_image import CHANNELS, RangeImage, SensorProfile, project
from workers.points.se3 import inverse, transform
from workers.supervised.residual_image import ResidualSettings, residual_image


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One frame with its truth.

    Attributes:
        frame: The frame, decoded as in a worker.
        semantic: (N,) class, 0 where unlabelled.
        motion: (N,) 0 unknown, 1 static, 2 moving, as LMNet's classes.
        world_from_sensor: (4, 4) true pose at the middle of the sweep.
    """

    frame: LidarFrame
    semantic: NDArray[np.uint8]
    motion: NDArray[np.uint8]
    world_from_sensor: Transform


@dataclass(frozen=True, slots=True, eq=False)
class TrainingImages:
    """Frames as range images, before augmentation.

    Attributes:
        channels: (F, 5, H, W) range, x, y, z (metres), intensity (0 to 1); zero where empty.
        seen_mask: (F, H, W) true where a pixel shows a point.
        semantic: (F, H, W) class, 0 where unlabelled or empty.
        motion: (F, H, W) 0 unknown or empty, 1 static, 2 moving.
        residuals: (F, V, K, H, W) float16, V variants of the K residual images.
        ego_speed_m_per_s: (F,) speed of the car.
    """

    channels: NDArray[np.float32]
    seen_mask: NDArray[np.bool_]
    semantic: NDArray[np.uint8]
    motion: NDArray[np.uint8]
    residuals: NDArray[np.float16]
    ego_speed_m_per_s: NDArray[np.float64]


def build_images(
    clouds: Sequence[Cloud],
    profile: SensorProfile,
    settings: ResidualSettings,
    *,
    variants: Sequence[int],
    rng: np.random.Generator,
    only: range | None = None,
    noise_m: float = 0.02,
    noise_deg: float = 0.04,
) -> TrainingImages:
    """Project frames and compare each with its past, or with its future.

    A variant of 1 compares with the past, one of -1 with the future: the same scene played
    backwards. One of 2 compares with frames twice as old: the same scene at double speed, which
    adds ego speeds that are rare in the log. Each variant draws its own pose errors, to imitate
    real odometry.

    Args:
        clouds: Consecutive frames.
        profile: Layout of the images.
        settings: Ages and gate of the residuals; no ages, no residuals.
        variants: Direction and speed in time of each variant, such as 1, -1, 2, -2.
        rng: Source of the pose errors.
        only: Frames that become images; residuals may use all frames. None for all.
        noise_m: Standard deviation of the position error of each axis, metres.
        noise_deg: Standard deviation of the rotation error about each axis.

    Returns:
        Images of all frames.
    """
    wanted = range(len(clouds)) if only is None else only
    images = [
        project(cloud.frame.points_m, profile, valid_mask=cloud.frame.valid_mask)
        for cloud in clouds
    ]
    size = (profile.rows, profile.columns)
    channels = np.zeros((len(wanted), len(CHANNELS), *size), dtype=np.float32)
    semantic = np.zeros((len(wanted), *size), dtype=np.uint8)
    motion = np.zeros_like(semantic)
    residuals = np.zeros(
        (len(wanted), len(variants), len(settings.ages_s), *size), dtype=np.float16
    )
    for number, index in enumerate(wanted):
        cloud, image = clouds[index], images[index]
        seen = image.index >= 0
        shown = image.index[seen]
        channels[number][:, seen] = np.stack(
            [
                image.point_range_m[shown],
                *cloud.frame.points_m[shown].T,
                cloud.frame.intensity[shown],
            ]
        )
        semantic[number][seen] = cloud.semantic[shown]
        motion[number][seen] = cloud.motion[shown]
        for variant, speed in enumerate(variants):
            for age, age_s in enumerate(settings.ages_s):
                other = _at(
                    clouds, cloud.frame.stamp_ns - speed * round(age_s * NS_PER_S), settings
                )
                if other is None:
                    continue
                error = _pose_error(rng, noise_m=noise_m, noise_deg=noise_deg)
                now_from_other = (
                    error @ inverse(cloud.world_from_sensor) @ clouds[other].world_from_sensor
                )
                moved = transform(now_from_other, _visible(clouds[other], images[other]))
                residuals[number, variant, age] = residual_image(image, moved, profile, settings)
    seen_mask = np.stack([images[index].index >= 0 for index in wanted])
    speeds = _speeds_m_per_s(clouds)[list(wanted)]
    return TrainingImages(channels, seen_mask, semantic, motion, residuals, speeds)


def _speeds_m_per_s(clouds: Sequence[Cloud]) -> NDArray[np.float64]:
    """Return the speed of the car at each frame, by differences of the true positions."""
    if len(clouds) == 1:
        return np.zeros(1)
    times_s = (
        np.array([cloud.frame.stamp_ns - clouds[0].frame.stamp_ns for cloud in clouds]) / NS_PER_S
    )
    positions_m = np.stack([cloud.world_from_sensor[:3, 3] for cloud in clouds])
    speeds: NDArray[np.float64] = np.linalg.norm(np.gradient(positions_m, times_s, axis=0), axis=1)
    return speeds


def _visible(cloud: Cloud, image: RangeImage) -> Points:
    """Return the points visible in the image, as the stream's memory contains them."""
    return cloud.frame.points_m[image.index[image.index >= 0]]


def _at(clouds: Sequence[Cloud], time_ns: int, settings: ResidualSettings) -> int | None:
    """Return the index of the frame nearest to a time, if near enough."""
    distances = [abs(cloud.frame.stamp_ns - time_ns) for cloud in clouds]
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] <= settings.tolerance_s * NS_PER_S else None


def _pose_error(rng: np.random.Generator, *, noise_m: float, noise_deg: float) -> Transform:
    error: Transform = np.eye(4)
    rotation = Rotation.from_rotvec(rng.normal(scale=np.radians(noise_deg), size=3))
    error[:3, :3] = rotation.as_matrix()
    error[:3, 3] = rng.normal(scale=noise_m, size=3)
    return error
