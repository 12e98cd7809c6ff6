"""Limits of a car's motion, and the noise of its poses."""

from typing import Final

MAX_ACCELERATION_M_PER_S2: Final = 12.0
"""Largest acceleration, m/s²: full braking on a dry road, with a kerb on top."""


POSE_NOISE_M: Final = 0.15


POSE_NOISE_RAD: Final = 0.01
"""Noise of poses in the worst single frames on real logs; typical frames have 0.02 m, 0.001 rad."""
