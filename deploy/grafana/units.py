"""Formatting of numbers as in Grafana, for the units of our panels."""

from collections.abc import Callable, Sequence
from typing import Final

SHORT: Final = ((1e9, " Bil"), (1e6, " Mil"), (1e3, " K"))
BYTES: Final = ((2**40, " TiB"), (2**30, " GiB"), (2**20, " MiB"), (2**10, " KiB"))
TIME: Final = ((86_400, " days"), (3600, " h"), (60, " min"))


def written(value: float, unit: str, *, decimals: int | None = None) -> str:
    """Format a number with its unit.

    Args:
        value: In the base unit.
        unit: Grafana's id: short, percentunit, s, bytes, Bps or reqps.
        decimals: Digits after the point; None: three significant ones.

    Raises:
        KeyError: If the unit is none of them.
    """
    return _UNITS[unit](value, decimals)


def _digits(value: float, decimals: int | None) -> str:
    return (
        f"{value:.3g}" if decimals is None and abs(value) < 1000 else f"{value:.{decimals or 0}f}"
    )


def _scaled(
    value: float, decimals: int | None, steps: Sequence[tuple[float, str]], smallest: str
) -> str:
    for size, name in steps:
        if abs(value) >= size:
            return f"{_digits(value / size, decimals)}{name}"
    return f"{_digits(value, decimals)}{smallest}"


def _seconds(value: float, decimals: int | None) -> str:
    if 0 < abs(value) < 1:
        return f"{_digits(value * 1000, decimals)} ms"
    return _scaled(value, decimals, TIME, " s")


_UNITS: Final[dict[str, Callable[[float, int | None], str]]] = {
    "short": lambda value, decimals: _scaled(value, decimals, SHORT, ""),
    "percentunit": lambda value, decimals: f"{_digits(value * 100, decimals)}%",
    "s": _seconds,
    "bytes": lambda value, decimals: _scaled(value, decimals, BYTES, " B"),
    "Bps": lambda value, decimals: f"{_scaled(value, decimals, BYTES, ' B')}/s",
    "reqps": lambda value, decimals: f"{_digits(value, decimals)} req/s",
}
