"""Augmentation of the publications: points are shifted, mirrored and dropped, then projected."""

import numpy as np

from workers.lab.training.augment import Sample
from workers.lidar.range_image import SensorProfile, project

_LIKELY = 0.5
"""Probability of any change, and of each change given one; as published."""

_MOST_DROPPED = 0.5
"""Largest share of dropped points; as published."""


def published_augment(sample: Sample, rng: np.random.Generator, *, layout: SensorProfile) -> Sample:
    """Change one image as the training of SalsaNext and LiDAR-MOS does.

    Half of the images stay. Of the others each half is shifted by up to 5, 3 and 1 m, is mirrored,
    and loses up to half of its points. The points are then projected again. Residual images are not
    changed, as in the published code, which computes them before the training.

    Args:
        sample: The whole image.
        rng: Random generator.
        layout: Layout of the image.

    Returns:
        A new sample of the same size, or the sample itself.
    """
    if rng.random() > _LIKELY:
        return sample
    seen = sample.seen_mask
    channels, labels = sample.channels[:, seen], sample.labels[seen]
    points_m = channels[1:4].T.copy()
    if rng.random() > _LIKELY:
        points_m += np.array(
            [rng.uniform(-5, 5), rng.uniform(-3, 3), rng.uniform(-1, 0)], dtype=np.float32
        )
    if rng.random() > _LIKELY:
        points_m[:, 1] *= -1
    if rng.random() > _LIKELY:
        kept = rng.random(len(points_m)) >= rng.uniform(0, _MOST_DROPPED)
        points_m, channels, labels = points_m[kept], channels[:, kept], labels[kept]
    image = project(points_m, layout)
    shown = image.index >= 0
    index = image.index[shown]
    projected = np.zeros_like(sample.channels)
    projected[:, shown] = np.stack(
        [image.point_range_m[index], *points_m[index].T, channels[4][index]]
    )
    moved = np.zeros_like(sample.labels)
    moved[shown] = labels[index]
    return Sample(projected, sample.residuals, shown, moved)
