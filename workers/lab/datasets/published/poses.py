"""Poses of data sets from a translation and a quaternion."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from schemas.arrays import Transform


def pose_of(
    translation_m: Sequence[float] | NDArray[np.float64], quaternion_wxyz: Sequence[float]
) -> Transform:
    """Return a (4, 4) pose from a translation and a quaternion, scalar first."""
    w, x, y, z = (float(each) for each in quaternion_wxyz)
    pose: Transform = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = translation_m
    return pose
