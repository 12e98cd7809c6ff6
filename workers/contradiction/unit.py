"""Numbers between 0 and 1."""


def clip(value: float) -> float:
    """The nearest number from 0 to 1."""
    return min(1.0, max(0.0, value))
