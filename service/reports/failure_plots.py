"""Plots of the failure benchmark as inline SVG."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Final

from schemas.visible import visible

COLOURS: Final = (
    *("#2f5bea", "#d9480f", "#2b8a3e", "#862e9c", "#c2255c"),
    *("#0b7285", "#e67700", "#495057", "#5c940d", "#364fc7"),
)
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _LEGEND = 460, 320, 46, 36, 190
_TICKS: Final = 5

Line = Sequence[tuple[float, float]]


def plot(
    title: str,
    lines: Mapping[str, Line],
    *,
    x: str,
    y: str,
    dots: bool = False,
    diagonal: bool = False,
) -> str:
    """Draw lines over 0 to 1.

    Args:
        title: Title of the plot.
        lines: By name, (x, y) from left to right; the first is drawn thick.
        x: Label of the horizontal axis.
        y: Label of the vertical axis.
        dots: Mark each point.
        diagonal: Draw the diagonal of a calibrated probability.
    """

    def at(point: tuple[float, float]) -> str:
        across = _LEFT + point[0] * (_WIDTH - _LEFT - 10)
        up = _HEIGHT - _BOTTOM - min(point[1], 1.0) * (_HEIGHT - _BOTTOM - 30)
        return f"{across:.1f},{up:.1f}"

    parts = [f'<text x="{_LEFT}" y="18" class="title">{_safe(title)}</text>']
    for tick in range(_TICKS + 1):
        share = tick / _TICKS
        left, right = at((0.0, share)), at((1.0, share))
        label_x, label_y = at((share, 0.0)).split(",")
        parts += [
            f'<polyline points="{left} {right}" class="grid"/>',
            f'<text x="{_LEFT - 6}" y="{left.split(",")[1]}" class="tick end">{share:.1f}</text>',
            f'<text x="{label_x}" y="{float(label_y) + 14:.1f}" class="tick mid">'
            f"{share:.1f}</text>",
        ]
    if diagonal:
        parts.append(f'<polyline points="{at((0, 0))} {at((1, 1))}" class="diagonal"/>')
    for place, (name, line) in enumerate(lines.items()):
        colour = COLOURS[place % len(COLOURS)]
        points = " ".join(at(point) for point in line)
        width = 3 if place == 0 else 1.5
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
        )
        for point in line if dots else ():
            across, up = at(point).split(",")
            parts.append(f'<circle cx="{across}" cy="{up}" r="4" fill="{colour}"/>')
        if len(lines) > 1:
            high = 40 + 18 * place
            parts.append(
                f'<rect x="{_WIDTH + 8}" y="{high - 9}" width="12" height="4" fill="{colour}"/>'
                f'<text x="{_WIDTH + 26}" y="{high - 3}" class="tick">{_safe(name)}</text>'
            )
    middle = (_LEFT + _WIDTH) / 2
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 4}" class="tick mid">{_safe(x)}</text>')
    parts.append(
        f'<text x="12" y="{_HEIGHT / 2}" class="tick mid" '
        f'transform="rotate(-90 12 {_HEIGHT / 2})">{_safe(y)}</text>'
    )
    wide = _WIDTH + (_LEGEND if len(lines) > 1 else 0)
    return f'<svg viewBox="0 0 {wide} {_HEIGHT}" width="{wide}">{"".join(parts)}</svg>'


def _safe(text: str) -> str:
    return escape(visible(text))


def html_table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format rows as an HTML table; None is an empty cell."""
    head = "".join(f"<th>{_safe(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else _safe(str(value))
