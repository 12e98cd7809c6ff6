"""Small charts as shapes, which templates write as SVG with classes and without styles. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Final

from service.web.phrases import grouped

WIDTH: Final = 640
HEIGHT: Final = 190
LEFT: Final = 46
RIGHT: Final = 10
TOP: Final = 10
BOTTOM: Final = 26
"""Size of a chart and its margins, in units of its view box."""

_LABELS: Final = 6
"""Labels of the time axis at most."""

_MOST_BAR: Final = 34.0

_MEASURED: Final = (1, 2, 2.5, 5, 10)
_COUNTED: Final = (2, 4, 6, 10, 20)
"""Upper edges of a chart, times a power of ten; the half of a count's edge is an integer."""

_GROUPED: Final = 1000


@dataclass(frozen=True, slots=True)
class Sample:
    """One value of a series.

    Attributes:
        place: Index on the time axis; a step above 1 from the one before breaks the line.
        label: Its time, for the axis.
        value: Its value; None: there is none, and the line has a gap.
        title: Text of its tip, and its name for screen readers.
        href: Address of its scenes.
        low: Lower bound of its interval; None: there is none.
        high: Upper bound of its interval.
    """

    place: int
    label: str
    value: float | None
    title: str
    href: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class Mark:
    """A point or a bar of a chart, which is a link."""

    x: float
    y: float
    width: float
    height: float
    title: str
    href: str


@dataclass(frozen=True, slots=True)
class Chart:
    """Shapes of a chart.

    Attributes:
        marks: Points of a line, or bars.
        line: Path of the line; empty for bars.
        band: Path of the interval around the line; empty without one.
        ticks: Height and label of each line of the grid.
        labels: Place and label of each named time.
    """

    marks: Sequence[Mark]
    line: str
    band: str
    ticks: Sequence[tuple[float, str]]
    labels: Sequence[tuple[float, str]]
    width: int = WIDTH
    height: int = HEIGHT


def line_chart(
    samples: Sequence[Sample], *, top: float | None = None, percent: bool = False
) -> Chart:
    """Draw a line through the values, with a band where they have an interval.

    Args:
        samples: Values in the order of time.
        top: Value at the upper edge; None: rounded up from the largest one.
        percent: Label the grid in percent.
    """
    known = [each for each in samples if each.value is not None]
    peak = top or _ceiling(max((each.value or 0.0 for each in known), default=0.0))
    x_of = _places(samples)
    xy = [(x_of[each.place], _y(each.value or 0.0, peak)) for each in known]
    marks = [
        Mark(x, y, 0, 0, each.title, each.href) for (x, y), each in zip(xy, known, strict=True)
    ]
    line = "".join(
        f"{'M' if i == 0 or known[i].place > known[i - 1].place + 1 else 'L'}{x:.1f},{y:.1f}"
        for i, (x, y) in enumerate(xy)
    )
    bounded = [(x_of[s.place], s.low, s.high) for s in known if s.low is not None]
    upper = [f"{x:.1f},{_y(high or 0.0, peak):.1f}" for x, _, high in bounded]
    lower = [f"{x:.1f},{_y(low or 0.0, peak):.1f}" for x, low, _ in reversed(bounded)]
    band = f"M{'L'.join(upper + lower)}Z" if len(bounded) > 1 else ""
    return Chart(marks, line, band, _ticks(peak, percent=percent), _labels(samples, x_of))


def bar_chart(samples: Sequence[Sample]) -> Chart:
    """Draw a bar for each count."""
    peak = _ceiling(max((each.value or 0.0 for each in samples), default=0.0), _COUNTED)
    x_of = _places(samples)
    step = (WIDTH - LEFT - RIGHT) / max(1, len(x_of))
    width = min(_MOST_BAR, max(1.5, 0.7 * step))
    floor_y = HEIGHT - BOTTOM
    marks = [
        Mark(x_of[s.place] - width / 2, y, width, floor_y - y, s.title, s.href)
        for s in samples
        for y in (_y(s.value or 0.0, peak),)
    ]
    return Chart(marks, "", "", _ticks(peak, percent=False), _labels(samples, x_of))


def _places(samples: Sequence[Sample]) -> dict[int, float]:
    """Return the x of each place: samples are next to each other, whatever time is between."""
    count = len(samples)
    step = (WIDTH - LEFT - RIGHT) / max(1, count)
    return {each.place: LEFT + step * (i + 0.5) for i, each in enumerate(samples)}


def _y(value: float, peak: float) -> float:
    return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * min(1.0, value / peak)


def _ceiling(value: float, steps: Sequence[float] = _MEASURED) -> float:
    """Round up to one of the steps times a power of ten."""
    if value <= 0:
        return float(steps[0])
    power = 10.0 ** floor(log10(value))
    return float(next(s * power for s in steps if s * power >= value * (1 - 1e-9)))


def _ticks(peak: float, *, percent: bool) -> list[tuple[float, str]]:
    return [(_y(peak * part, peak), _tick(peak * part, percent=percent)) for part in (0, 0.5, 1)]


def _tick(value: float, *, percent: bool) -> str:
    if percent:
        return f"{100 * value:.3g} %"
    return grouped(round(value)) if value >= _GROUPED else f"{value:.3g}"


def _labels(samples: Sequence[Sample], x_of: dict[int, float]) -> list[tuple[float, str]]:
    every = max(1, ceil(len(samples) / _LABELS))
    return [(x_of[each.place], each.label) for each in samples[::every]]
