"""Picture of the outcomes by data set: bars of the paper's four categories, in its colours."""

from collections.abc import Mapping
from math import ceil, log10
from typing import Final

from PIL import Image, ImageDraw

from schemas.task import MOTION
from service.curation.rates import OutcomePoints
from service.pictures.style import (
    BACKGROUND,
    GRID,
    SOFT_TEXT,
    TEXT,
    colours_of,
    font,
    meaning,
    shorten,
)

_LEFT: Final = 84
_TOP: Final = 54
_PLOT_HEIGHT: Final = 300
_BAR: Final = 34
_GAP: Final = 26
_TEXT_PX: Final = 13

_CATEGORIES: Final = (
    *("both_static", "both_dynamic"),
    *("only_predictive_dynamic", "only_semantic_dynamic"),
)
"""Fields of the outcomes in the paper's order, categories 1 to 4."""

_CODES: Final = (0, 3, 2, 1)
"""Their codes in the task of motion."""


def draw_outcomes(found: Mapping[str, OutcomePoints]) -> Image.Image:
    """Draw compared points by outcome and data set, on a logarithmic axis.

    Above each bar is its share of the compared points of the data set.

    Args:
        found: Points by data set, drawn in this order.
    """
    group = len(_CATEGORIES) * _BAR + _GAP
    most = max((getattr(each, name) for each in found.values() for name in _CATEGORIES), default=1)
    decades = max(1, ceil(log10(max(most, 10))))
    width = max(_LEFT + group * len(found) + _GAP, 640)
    image = Image.new("RGB", (width, _TOP + _PLOT_HEIGHT + 96), BACKGROUND)
    draw = ImageDraw.Draw(image)
    draw.text((16, 14), "compared points by outcome and data set", fill=TEXT, font=font(17))
    bottom = _TOP + _PLOT_HEIGHT
    for decade in range(decades + 1):
        y = bottom - _PLOT_HEIGHT * decade // decades
        draw.line((_LEFT, y, width - 16, y), fill=GRID)
        draw.text((_LEFT - 8, y), f"1e{decade}", fill=SOFT_TEXT, font=font(_TEXT_PX), anchor="rm")
    colours = colours_of(MOTION)
    for place, (name, points) in enumerate(found.items()):
        left = _LEFT + _GAP // 2 + place * group
        counts = [getattr(points, category) for category in _CATEGORIES]
        for bar, (count, code) in enumerate(zip(counts, _CODES, strict=True)):
            x = left + bar * _BAR
            height = round(_PLOT_HEIGHT * log10(count) / decades) if count > 1 else 0
            draw.rectangle((x, bottom - height, x + _BAR - 5, bottom), fill=colours[code])
            share = f"{100 * count / max(sum(counts), 1):.1f}%"
            at = (x + (_BAR - 5) / 2, bottom - height - 4)
            draw.text(at, share, fill=SOFT_TEXT, font=font(10), anchor="ms")
        label = shorten(name, group - 8, _TEXT_PX)
        middle = (left + len(_CATEGORIES) * _BAR / 2, bottom + 8)
        draw.text(middle, label, fill=TEXT, font=font(_TEXT_PX), anchor="mt")
    _draw_legend(draw, bottom + 40)
    return image


def _draw_legend(draw: ImageDraw.ImageDraw, top: int) -> None:
    colours = colours_of(MOTION)
    for place, code in enumerate(_CODES):
        x, y = 16 + 300 * (place % 2), top + 22 * (place // 2)
        draw.rectangle((x, y, x + 12, y + 12), fill=colours[code])
        text = f"{place + 1} {meaning(MOTION.outcomes[code], MOTION)}"
        draw.text((x + 20, y - 2), text, fill=SOFT_TEXT, font=font(_TEXT_PX))
