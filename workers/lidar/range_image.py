"""Range image by spherical projection of a frame, with the pixel of each point."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.lidar.fidelity import Form
from workers.lidar.pixels import (
    UNSURE,
    Gaps,
    gaps_between,
    nearest_of_pixels,
    normalised,
    place_points,
)

Channel = Literal["range", "x", "y", "z", "intensity"]

CHANNELS: Final[tuple[Channel, ...]] = ("range", "x", "y", "z", "intensity")
"""Channels of a pixel for a network, in the published order (SalsaNext, LiDAR-MOS)."""

MAX_PIXELS: Final = 1 << 20
"""Pixels of a range image at most: four times those of the largest lidars, 128 rows of 2048."""


@dataclass(frozen=True)
class SensorProfile:
    """Layout of a lidar's range image, and the normalisation of its measurements.

    Attributes:
        name: Name in messages.
        rows: Height of the range image.
        columns: Width of the range image; column 0 looks backwards, the middle looks forward.
        fov_up_deg: Upper edge of the vertical field of view.
        fov_down_deg: Lower edge of the vertical field of view, below the horizon negative.
        elevations_deg: Elevation of each row's beam, highest first; None spaces rows evenly. Beams
            of many lidars crowd near the horizon, where even rows would merge four of them.
        clamp: Put points outside the field of view into the first or last row, as the published
            code does; otherwise they stay unprojected.
        means: Mean of range, x, y, z (metres) and intensity (0 to 1) over the training frames.
        stds: Their standard deviations.
        fitted: Rows, field of view and elevations are measured in the first frame of a log
            (`sensor_rows.lay_out`), for any sensor; `rows` is their maximum. The network was
            trained with several sensors.

    Raises:
        ValueError: If the numbers contradict each other.
    """

    name: str
    rows: int
    columns: int
    fov_up_deg: float
    fov_down_deg: float
    elevations_deg: tuple[float, ...] | None = None
    clamp: bool = False
    means: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    stds: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0)
    fitted: bool = False

    def __post_init__(self) -> None:
        """Refuse a profile that no image can have."""
        if max(self.rows, self.columns) > MAX_PIXELS or self.rows * self.columns > MAX_PIXELS:
            raise ValueError(
                f"profile {self.name!r} has {self.rows} rows and {self.columns} columns: a range "
                f"image has at most {MAX_PIXELS:,} pixels"
            )
        numbers = (self.fov_up_deg, self.fov_down_deg, *self.means, *self.stds)
        if not np.isfinite((*numbers, *(self.elevations_deg or ()))).all():
            raise ValueError(f"profile {self.name!r} has a number that is not finite")
        if self.rows < 1 or self.columns < 1 or self.fov_up_deg <= self.fov_down_deg:
            raise ValueError(f"profile {self.name!r} has no pixels: check rows, columns and fov")
        if len(self.means) != len(CHANNELS) or len(self.stds) != len(CHANNELS):
            raise ValueError(f"profile {self.name!r} needs a mean and std of each of {CHANNELS}")
        if min(self.stds) <= 0:
            raise ValueError(f"profile {self.name!r} has a standard deviation that is not positive")
        beams = self.elevations_deg
        if beams is not None and (len(beams) != self.rows or any(np.diff(np.asarray(beams)) >= 0)):
            raise ValueError(
                f"profile {self.name!r} needs {self.rows} falling beam elevations, one a row"
            )

    @property
    def layout(self) -> tuple[object, ...]:
        """Fields that determine the pixel of a point; profiles with equal ones share an image."""
        return (
            self.rows,
            self.columns,
            self.fov_up_deg,
            self.fov_down_deg,
            self.elevations_deg,
            self.clamp,
            self.fitted,
        )

    @cached_property
    def row_edges_rad(self) -> NDArray[np.float32]:
        """Inner edges between rows, rising, midway between neighbouring beams."""
        beams = np.radians(np.asarray(self.elevations_deg, dtype=np.float64))[::-1]
        return ((beams[1:] + beams[:-1]) / 2).astype(np.float32)

    def row_of(
        self, elevation_rad: NDArray[np.floating], *, clamp: bool = False
    ) -> NDArray[np.int32]:
        """Return the row of each elevation; -1 outside the field of view unless clamped."""
        number = elevation_rad.dtype.type
        up, down = number(np.radians(self.fov_up_deg)), number(np.radians(self.fov_down_deg))
        row: NDArray[np.int32]
        if self.elevations_deg is None:
            share = number(1) - (elevation_rad - down) / (up - down)
            row = np.floor(share * number(self.rows)).astype(np.int32)
            row = np.clip(row, 0, self.rows - 1)
        else:
            below = np.searchsorted(self.row_edges_rad, elevation_rad)
            row = (self.rows - 1 - below).astype(np.int32)
        if not (clamp or self.clamp):
            row[(elevation_rad > up) | (elevation_rad < down)] = -1
        return row


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """A range image of a frame, with the pixel of each point.

    Attributes:
        index: (H, W) int32, point of each pixel; -1 where there is none.
        range_m: (H, W) float32, distance of that point; -1 where there is none.
        row: (N,) int32, row of each point; -1 where the point is not projected.
        column: (N,) int32, column of each point; -1 where the point is not projected.
        point_range_m: (N,) float32, distance of each point, metres; zero where invalid.
        form: Fidelity of the projection to the published code.
    """

    index: NDArray[np.int32]
    range_m: NDArray[np.float32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]
    point_range_m: NDArray[np.float32]
    form: Form = Form.CORRECTED

    @property
    def seen_mask(self) -> Mask:
        """(H, W) true where a network sees a point; in the paper's form the first is not seen."""
        return self.index >= self.least_seen

    @property
    def least_seen(self) -> int:
        """Smallest index that a network sees; pixels of a lower one are empty to it."""
        return 1 if self.form is Form.PAPER else 0

    @property
    def projected_mask(self) -> Mask:
        """(N,) true where a point has a pixel, seen in it or hidden behind a nearer one."""
        return self.row >= 0


def project(
    points_m: Points,
    profile: SensorProfile,
    *,
    valid_mask: Mask | None = None,
    gate_m: tuple[float, float] | None = None,
    form: Form = Form.CORRECTED,
    precision: type[np.float32] | type[np.float64] = np.float32,
) -> RangeImage:
    """Project points to a range image; of several in one pixel the nearest is seen.

    The layout is that of RangeNet++ and SalsaNext: columns by azimuth, clockwise from behind; rows
    by elevation, top first. The corrected form differs from the published code:

    - the pixel of the point with index 0 counts as seen (published: as empty, `seen_mask`);
    - points above and below the field of view stay out (published: in the first and last row);
    - of two equally near points the lower index wins (published: either; so here in both forms);
    - points at the origin and invalid ones stay out (published: the program ends; here in both).

    Args:
        points_m: (N, 3) sensor space, metres.
        profile: The layout of the image; one that clamps does so in both forms.
        valid_mask: (N,) points that may be projected; None for all.
        gate_m: Only points farther than the first and nearer than the second are projected.
        form: Fidelity to the published code.
        precision: Of the arithmetic. SalsaNext's loader has single, LMNet's double precision; the
            two differ in about ten pixels of a frame.

    Returns:
        The image; points that are invalid or outside the field of view have row -1.
    """
    points: NDArray[np.floating] = points_m.astype(precision, copy=False)
    valid = np.ones(len(points), np.bool_) if valid_mask is None else valid_mask
    low, high = (0.0, np.inf) if gate_m is None else gate_m
    clamp = form is Form.PAPER
    range_m = np.empty(len(points), precision)
    row, column = np.empty((2, len(points)), np.int32)
    gaps = _gaps_of(profile, clamp)
    place_points(
        points,
        valid,
        precision(low),
        precision(high),
        gaps,
        profile.columns,
        range_m,
        row,
        column,
    )
    unsure = np.flatnonzero(row == UNSURE)
    row[unsure], column[unsure] = _pixels(points[unsure], range_m[unsure], profile, clamp=clamp)
    shape = (profile.rows, profile.columns)
    index, image = np.full(shape, -1, np.int32), np.full(shape, -1, precision)
    nearest_of_pixels(row, column, range_m, index, image)
    image_m, own_m = (each.astype(np.float32, copy=False) for each in (image, range_m))
    return RangeImage(index, image_m, row, column, own_m, form)


@lru_cache(maxsize=16)
def _gaps_of(profile: SensorProfile, clamp: bool) -> Gaps:
    """Return the edges between rows, and of the field of view, with the rows between them."""
    up, down = np.radians(profile.fov_up_deg), np.radians(profile.fov_down_deg)
    if profile.elevations_deg is None:
        edges = np.linspace(down, up, profile.rows + 1)
    else:
        edges = np.union1d(profile.row_edges_rad, (down, up)).astype(np.float64)
    edges = np.clip(edges, -np.pi / 2, np.pi / 2)
    ends = np.concatenate(([-np.pi / 2], edges, [np.pi / 2]))
    return gaps_between(edges, profile.row_of((ends[1:] + ends[:-1]) / 2, clamp=clamp))


def _pixels(
    points: NDArray[np.floating],
    range_m: NDArray[np.floating],
    profile: SensorProfile,
    *,
    clamp: bool,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the row, -1 for none, and column of points, computed as in the published code."""
    precision = points.dtype.type
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    share = precision(0.5) * (-np.arctan2(y, x) / precision(np.pi) + precision(1))
    row = profile.row_of(np.arcsin(np.clip(z / range_m, -1, 1)), clamp=clamp)
    column = np.clip(np.floor(share * precision(profile.columns)), 0, profile.columns - 1)
    return row, np.where(row >= 0, column, -1).astype(np.int32)


def image_channels(
    image: RangeImage, points_m: Points, intensity: NDArray[np.float32], profile: SensorProfile
) -> NDArray[np.float32]:
    """Return the measurements as the normalised input of a network.

    Args:
        image: Projection of the same points.
        points_m: (N, 3) sensor space, metres.
        intensity: (N,) 0 to 1.
        profile: Means and standard deviations of the channels.

    Returns:
        (5, H, W) float32 in the order of `CHANNELS`; zero in empty pixels.
    """
    return normalised(
        image.index,
        image.least_seen,
        image.point_range_m,
        points_m,
        intensity,
        np.array(profile.means, np.float32),
        np.array(profile.stds, np.float32),
    )
