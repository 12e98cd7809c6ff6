"""From pixels back to points: k nearest neighbours vote where a pixel cannot speak for all."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from schemas.arrays import Mask
from workers.geometry.form import Form
from workers.geometry.range_image import RangeImage


@dataclass(frozen=True, slots=True)
class KnnSettings:
    """The published numbers of RangeNet++, used by SalsaNext and LiDAR-MOS.

    Attributes:
        neighbours: How many nearest pixels vote.
        window: Side of the square that is searched, pixels, odd.
        sigma: Of the Gaussian that discounts near pixels, pixels.
        cutoff_m: Pixels farther than this in (discounted) range do not vote.
        form: CORRECTED differs from the published code in this: the first and last column are
            neighbours, as they are on the sensor; beyond the image there is nothing (published:
            returns at range 0, whose votes are lost, for what is nearer than the cutoff); who has
            no voter has no class (published: class 1).
    """

    neighbours: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff_m: float = 1.0
    form: Form = Form.CORRECTED

    @property
    def wrap(self) -> bool:
        """Whether the first column continues the last."""
        return self.form is Form.CORRECTED


@dataclass(frozen=True, slots=True, eq=False)
class Voters:
    """Who decides for which point.

    Attributes:
        own_pixel: (N,) flat pixel of each point, -1 where it is not projected.
        contested: (M,) points whose surroundings disagree; all others follow their own pixel.
        pixel: (M, k) flat pixels that vote for them, -1 where fewer are near enough.
        form: What becomes of points without a vote.
    """

    own_pixel: NDArray[np.int32]
    contested: NDArray[np.intp]
    pixel: NDArray[np.int32]
    form: Form = Form.CORRECTED

    def look_up(self, class_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Give each point the class of its own pixel, as without this step; 0 where it has none."""
        return np.where(self.own_pixel >= 0, class_image.ravel()[self.own_pixel], np.uint8(0))

    def vote(self, class_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Give each point the commonest class of its voters, the lowest id on a tie.

        Args:
            class_image: (H, W) class of each pixel, 0 for none; one of those given to
                `find_voters`.

        Returns:
            (N,) class of each point; 0 where it is not projected, or (corrected) nobody votes.
        """
        flat = class_image.ravel()
        labels = self.look_up(class_image)
        if len(self.contested):
            ballots = np.where(self.pixel >= 0, flat[self.pixel], np.uint8(0)).astype(np.intp)
            classes = int(flat.max()) + 1
            offset = np.arange(len(ballots))[:, None] * classes
            counts = np.bincount((ballots + offset).ravel(), minlength=ballots.shape[0] * classes)
            counts = counts.reshape(-1, classes)
            counts[:, 0] = 0
            winners = counts.argmax(axis=1)
            if self.form is Form.PAPER:
                winners[winners == 0] = 1
            labels[self.contested] = winners
        return labels

    def average(self, value_image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Give each point the mean value of its voters.

        Args:
            value_image: (H, W).

        Returns:
            (N,) float32; zero where a point is not projected or nobody votes.
        """
        flat = value_image.ravel()
        values = np.where(self.own_pixel >= 0, flat[self.own_pixel], np.float32(0))
        if len(self.contested):
            votes = self.pixel >= 0
            sums = np.where(votes, flat[self.pixel], np.float32(0)).sum(axis=1)
            values[self.contested] = sums / np.maximum(votes.sum(axis=1), 1)
        return values.astype(np.float32)


def find_voters(
    image: RangeImage, class_images: Sequence[NDArray[np.uint8]], settings: KnnSettings
) -> Voters:
    """Find, for each point, the pixels near it in the image and in range.

    Source: Milioto et al., "RangeNet++", IROS 2019, algorithm 1. Points whose whole window shows
    one class are not searched: the centre always votes (its distance is zero), so the vote could
    only have that outcome.

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
        mixed |= _mixed(class_image, image.index >= 0, settings)
    contested = np.flatnonzero((own_pixel >= 0) & mixed.ravel()[own_pixel])
    return Voters(own_pixel, contested, _nearest(image, contested, settings), settings.form)


def _mixed(class_image: NDArray[np.uint8], seen: Mask, settings: KnnSettings) -> Mask:
    """Pixels in whose window more than one class, or class 0, is seen."""
    mode = ("nearest", "wrap" if settings.wrap else "nearest")
    highest = ndimage.maximum_filter(np.where(seen, class_image, 0), settings.window, mode=mode)
    lowest = ndimage.minimum_filter(np.where(seen, class_image, 255), settings.window, mode=mode)
    mixed: Mask = (highest != lowest) | (lowest == 0)
    return mixed


def _nearest(
    image: RangeImage, points: NDArray[np.intp], settings: KnnSettings
) -> NDArray[np.int32]:
    """Flat pixels of the k nearest neighbours of each point, -1 beyond the cutoff."""
    rows, columns = image.index.shape
    reach = settings.window // 2
    padded_columns = columns + 2 * reach
    ranges = np.where(image.index >= 0, image.range_m, np.float32(np.inf))
    flat = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    ranges, flat = (
        _pad(ranges, reach, 0 if settings.form is Form.PAPER else np.inf, wrap=settings.wrap),
        _pad(flat, reach, -1, wrap=settings.wrap),
    )
    steps = np.arange(-reach, reach + 1)
    offsets = (steps[:, None] * padded_columns + steps[None, :]).ravel()
    corner = (image.row[points] + reach) * padded_columns + image.column[points] + reach
    around = corner[:, None] + offsets
    own = image.point_range_m[points]
    distance = np.abs(ranges.ravel()[around] - own[:, None])
    distance[:, len(offsets) // 2] = 0  # the centre stands for the point itself
    distance *= _discount(steps, settings.sigma)
    nearest = np.argpartition(distance, settings.neighbours - 1, axis=1)[:, : settings.neighbours]
    chosen = np.take_along_axis(around, nearest, axis=1)
    near = np.take_along_axis(distance, nearest, axis=1) <= settings.cutoff_m
    return np.where(near, flat.ravel()[chosen], np.int32(-1))


def _pad(array: NDArray[np.generic], reach: int, fill: float, *, wrap: bool) -> NDArray[np.generic]:
    """Surround an image: nothing above and below, left and right nothing or the other side."""
    tall = np.pad(array, ((reach, reach), (0, 0)), constant_values=fill)
    sides = ((0, 0), (reach, reach))
    return np.pad(tall, sides, mode="wrap") if wrap else np.pad(tall, sides, constant_values=fill)


def _discount(steps: NDArray[np.int_], sigma: float) -> NDArray[np.float32]:
    """One minus the normalised Gaussian of each place in the window, row by row."""
    bell = np.exp(-(steps[:, None] ** 2 + steps[None, :] ** 2) / (2 * sigma**2))
    discount: NDArray[np.float32] = (1 - bell / bell.sum()).ravel().astype(np.float32)
    return discount
