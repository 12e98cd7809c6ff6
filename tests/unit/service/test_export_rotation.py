"""Rotations of cuboids, against those of SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from service.export.rotation import rotation_of_angles, rotation_of_quaternion


@pytest.mark.parametrize("order", ["xyz", "zyx"])
def test_three_angles_turn_about_the_axes_in_their_order(order: str) -> None:
    for angles in np.random.default_rng(5).uniform(-3, 3, (20, 3)):
        named = angles if order == "xyz" else angles[::-1]
        expected = Rotation.from_euler(order.upper(), named).as_matrix()
        np.testing.assert_allclose(rotation_of_angles(angles, order=order), expected, atol=1e-12)


def test_a_quaternion_of_any_length_turns_like_that_of_length_one() -> None:
    for quaternion in np.random.default_rng(6).normal(0, 2, (20, 4)):
        expected = Rotation.from_quat(quaternion).as_matrix()
        np.testing.assert_allclose(rotation_of_quaternion(quaternion), expected, atol=1e-12)


def test_four_zeros_are_no_quaternion() -> None:
    with pytest.raises(ValueError, match="no quaternion"):
        rotation_of_quaternion([0.0, 0.0, 0.0, 0.0])
