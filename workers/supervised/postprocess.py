"""Label back-projection from pixels to points by k-nearest-neighbour voting."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.lidar.fidelity import Form
from workers.lidar.pixel_windows import (
    look_up,
    majority_code,
    mean_of,
    mixed_windows,
    nearest_in_window,
    padded,
)
from workers.lidar.range_image import RangeImage


@dataclass(frozen=True, slots=True)
class KnnSettings:
    """Published parameters of RangeNet++, used by SalsaNext and LiDAR-MOS.

    Attributes:
        neighbours: Number of voting pixels.
        window: Side of the square that is searched, pixels, odd.
        sigma: Width of the Gaussian that discounts near pixels, pixels.
        cutoff_m: Pixels farther than this in (discounted) range do not vote.
        form: CORRECTED differs from the published code in this: the first and last column are
            neighbours, as on the sensor; pixels beyond the image are empty (published: returns at
            range 0, whose votes are lost, for points nearer than the cutoff); a point without a
            voter has no class (published: class 1).
    """

    neighbours: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff_m: float = 1.0
    form: Form = Form.CORRECTED

    @property
    def wrap(self) -> bool:
        """True if the first column continues the last."""
        return self.form is Form.CORRECTED


@dataclass(frozen=True, slots=True, eq=False)
class Voters:
    """Voting pixels of each point.

    Attributes:
        own_pixel: (N,) flat pixel of each point, -1 where it is not projected.
        contested: (M,) points whose window contains several classes; all others take that of their
            own pixel.
        pixel: (M, k) flat indices of their voting pixels, -1 where fewer are near enough.
        form: Form of the rule for points without a vote.
    """

    own_pixel: NDArray[np.int32]
    contested: NDArray[np.intp]
    pixel: NDArray[np.int32]
    form: Form = Form.CORRECTED

    def look_up(self, class_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the class of each point's own pixel, without voting; 0 where it has none."""
        return look_up(class_image, self.own_pixel, np.uint8(0))

    def vote(self, class_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the most frequent class of each point's voters, the lowest id on a tie.

        Args:
            class_image: (H, W) class of each pixel, 0 for none; one of those given to
                `find_voters`.

        Returns:
            (N,) class of each point; 0 where it is not projected, or (corrected) has no voter.
        """
        labels = self.look_up(class_image)
        nobody = np.uint8(1 if self.form is Form.PAPER else 0)
        labels[self.contested] = majority_code(class_image, self.pixel, nobody)
        return labels

    def average(self, value_image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean value of each point's voters.

        Args:
            value_image: (H, W).

        Returns:
            (N,) float32; zero where a point is not projected or has no voter.
        """
        values = look_up(value_image, self.own_pixel, np.float32(0))
        values[self.contested] = mean_of(value_image, self.pixel)
        return values


def find_voters(
    image: RangeImage, class_images: Sequence[NDArray[np.uint8]], settings: KnnSettings
) -> Voters:
    """Find, for each point, the pixels near it in the image and in range.

    Source: Milioto et al., "RangeNet++", IROS 2019, algorithm 1. Points whose window contains one
    class are not searched: the centre always votes (its distance is zero), so the outcome is
    certain.

    Args:
        image: Projection of the points.
        class_images: (H, W) class images that will be voted on.
        settings: Size of the search.

    Returns:
        The voters of every point.
    """
    columns = image.index.shape[1]
    own_pixel = np.where(image.row >= 0, image.row * np.int32(columns) + image.column, np.int32(-1))
    mixed = np.zeros(image.index.shape, dtype=np.bool_)
    for class_image in class_images:
        mixed |= mixed_windows(class_image, image.index, settings.window // 2, settings.wrap)
    contested = np.flatnonzero((own_pixel >= 0) & mixed.ravel()[own_pixel])
    return Voters(own_pixel, contested, _nearest(image, contested, settings), settings.form)


def _nearest(
    image: RangeImage, points: NDArray[np.intp], settings: KnnSettings
) -> NDArray[np.int32]:
    """Find the flat pixels of the k nearest neighbours of each point, -1 beyond the cutoff."""
    reach = settings.window // 2
    beyond = np.float32(0 if settings.form is Form.PAPER else np.inf)
    return nearest_in_window(
        padded(image.range_m, image.index, reach, beyond, settings.wrap),
        image.row,
        image.column,
        image.point_range_m,
        points,
        _discount(np.arange(-reach, reach + 1), settings.sigma),
        settings.neighbours,
        np.float32(settings.cutoff_m),
        settings.wrap,
    )


def _discount(steps: NDArray[np.int_], sigma: float) -> NDArray[np.float32]:
    """Return one minus the normalised Gaussian of each place in the window, (S, S)."""
    bell = np.exp(-(steps[:, None] ** 2 + steps[None, :] ** 2) / (2 * sigma**2))
    discount: NDArray[np.float32] = (1 - bell / bell.sum()).astype(np.float32)
    return discount
