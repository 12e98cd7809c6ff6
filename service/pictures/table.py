"""Plot of an evaluation: points by range, per log, and objects by kind."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from PIL import Image, ImageDraw

from service.pictures.style import BACKGROUND, GRID, PANEL, SOFT_TEXT, TEXT, Colour, font, shorten

if TYPE_CHECKING:
    from workers.lab.evaluation.motion.table import LogEvaluation

WIDTH_PX: Final = 1500
_MARGIN_PX: Final = 24
_NAMES_PX: Final = 420
_BAR_PX: Final = 14
_GROUP_PX: Final = 3 * _BAR_PX + 22
_ROW_PX: Final = _BAR_PX + 14
_LOW: Final = 0.5
"""Lower end of the bars' axis, below the compared values; shorter bars end at the edge."""

_RANGES: Final[Sequence[tuple[str, Colour]]] = (
    ("25", (92, 132, 255)),
    ("50", (86, 196, 220)),
    ("80", (132, 214, 150)),
)
_BAR: Final[Colour] = (92, 132, 255)


def draw_table(evaluated: Sequence["LogEvaluation"]) -> Image.Image:
    """Draw IoU, precision, recall and object recall of every log by range, objects by kind.

    Args:
        evaluated: A row for each log and stream, and last ones for all logs; logs without an
            evaluated frame are left out.
    """
    rows = [row for row in evaluated if row.frames]
    measures = ("iou", "confirmed_iou", "precision", "recall", "object_recall")
    names = [(row, measure) for row in rows for measure in measures]
    totals = [row for row in evaluated if row.log == evaluated[-1].log]
    kinds = [
        (f"{total.stream}, {by}: {kind}" if len(totals) > 1 else f"{by}: {kind}", share)
        for total in totals
        for by, shares in _by_kind(total).items()
        for kind, share in shares.items()
    ]
    height = 170 + _GROUP_PX * len(names) + 34 * len(rows) + _ROW_PX * len(kinds)
    image = Image.new("RGB", (WIDTH_PX, height), BACKGROUND)
    draw = ImageDraw.Draw(image)
    top = _legend(draw)
    for row in rows:
        title = f"{row.log}, {row.frames} frames, {row.stream} stream"
        draw.text((_MARGIN_PX, top), shorten(title, WIDTH_PX - 48, 20), fill=TEXT, font=font(20))
        top += 34
        for measure in measures:
            draw.text((_MARGIN_PX, top + 12), measure, fill=SOFT_TEXT, font=font(18))
            ratios: Mapping[str, float | None] = getattr(row, measure)
            for place, (range_m, colour) in enumerate(_RANGES):
                _bar(draw, top + place * (_BAR_PX + 2), ratios[range_m], colour)
            top += _GROUP_PX
    draw.text(
        (_MARGIN_PX, top), "moving objects found under 80 m, all logs", fill=TEXT, font=font(20)
    )
    top += 34
    for name, share in kinds:
        words = shorten(name, _NAMES_PX - _MARGIN_PX, 16)
        draw.text((_MARGIN_PX, top - 2), words, fill=SOFT_TEXT, font=font(16))
        _bar(draw, top, share, _BAR)
        top += _ROW_PX
    return image


def _by_kind(row: "LogEvaluation") -> dict[str, Mapping[str, float | None]]:
    return {
        "class": row.object_recall_by_class,
        "speed m/s": row.object_recall_by_speed,
        "longest side m": row.object_recall_by_size,
        "points": row.object_recall_by_points,
    }


def _legend(draw: ImageDraw.ImageDraw) -> int:
    """Draw the legend of colours and axis; return the top of the first row."""
    left = _NAMES_PX
    for range_m, colour in _RANGES:
        draw.rectangle((left, 22, left + 14, 36), fill=colour)
        draw.text((left + 22, 18), f"under {range_m} m", fill=SOFT_TEXT, font=font(18))
        left += 160
    for tenth in range(5, 11):
        x = _x(tenth / 10)
        draw.text((x, 52), f"{tenth / 10:.1f}", fill=SOFT_TEXT, font=font(15), anchor="ma")
        draw.line([(x, 74), (x, 80)], fill=GRID, width=2)
    return 92


def _bar(draw: ImageDraw.ImageDraw, top: int, share: float | None, colour: Colour) -> None:
    draw.rectangle((_x(_LOW), top, _x(1.0), top + _BAR_PX), fill=PANEL)
    if share is None:
        draw.text((_x(_LOW) + 6, top - 1), "nothing to count", fill=SOFT_TEXT, font=font(13))
        return
    if share > _LOW:
        draw.rectangle((_x(_LOW), top, _x(share), top + _BAR_PX), fill=colour)
    draw.text((_x(1.0) + 10, top - 1), f"{share:.3f}", fill=TEXT, font=font(14))


def _x(share: float) -> int:
    right = WIDTH_PX - _MARGIN_PX - 70
    return round(_NAMES_PX + (share - _LOW) / (1.0 - _LOW) * (right - _NAMES_PX))
