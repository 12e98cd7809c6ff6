"""Clamp numbers to the range from 0 to 1."""


def clamp01(value: float) -> float:
    """Return the nearest number from 0 to 1."""
    return min(1.0, max(0.0, value))
