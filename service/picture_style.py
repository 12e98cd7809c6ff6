"""Colours, fonts and marks that every picture of a scene shares."""

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import ImageFont

from schemas.contradiction import ContradictionKind
from schemas.labels import AGREEMENT_COLOURS, Agreement

Colour = tuple[int, int, int]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

BACKGROUND: Final[Colour] = (16, 18, 22)
PANEL: Final[Colour] = (26, 29, 35)
GRID: Final[Colour] = (52, 57, 66)
TEXT: Final[Colour] = (236, 238, 242)
SOFT_TEXT: Final[Colour] = (160, 166, 178)

KIND_AGREEMENT: Final = {
    ContradictionKind.ONLY_SEMANTIC_DYNAMIC: Agreement.ONLY_SEMANTIC_DYNAMIC,
    ContradictionKind.ONLY_PREDICTIVE_DYNAMIC: Agreement.ONLY_PREDICTIVE_DYNAMIC,
    ContradictionKind.ONLY_WITNESS_DYNAMIC: Agreement.BOTH_STATIC,
}

INK: Final[dict[Agreement, Colour]] = {
    **AGREEMENT_COLOURS,
    Agreement.BOTH_DYNAMIC: (105, 145, 255),
    Agreement.ONLY_PREDICTIVE_DYNAMIC: (255, 84, 84),
}
"""Lines and words in the paper's colours, its blue and red lightened to be read on dark."""

DRAW_ORDER: Final = (
    Agreement.NOT_COMPARED,
    Agreement.BOTH_STATIC,
    Agreement.BOTH_DYNAMIC,
    Agreement.ONLY_SEMANTIC_DYNAMIC,
    Agreement.ONLY_PREDICTIVE_DYNAMIC,
)
"""Later ones cover earlier ones: contradictions lie on top, on the camera image too."""

MEANING: Final[dict[Agreement, str]] = {
    Agreement.BOTH_STATIC: "both static",
    Agreement.BOTH_DYNAMIC: "both dynamic",
    Agreement.ONLY_SEMANTIC_DYNAMIC: "supervised stream alone says dynamic",
    Agreement.ONLY_PREDICTIVE_DYNAMIC: "self-supervised stream alone says dynamic",
    Agreement.NOT_COMPARED: "not compared",
}


@lru_cache(maxsize=16)
def font(size_px: int) -> Font:
    """Pillow's own scalable font: no font has to be installed."""
    return ImageFont.load_default(size=size_px)


def readable(text: str) -> str:
    """Replace what the built-in font has no glyphs for."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text)


def shorten(text: str, width_px: float, size_px: int) -> str:
    """Cut a text in its middle so that it fits; names differ at both of their ends."""
    text = readable(text)
    if font(size_px).getlength(text) <= width_px:
        return text
    fits, too_long = 2, len(text)
    while too_long - fits > 1:
        keep = (fits + too_long) // 2
        if font(size_px).getlength(_cut(text, keep)) <= width_px:
            fits = keep
        else:
            too_long = keep
    return _cut(text, fits)


def wrap(text: str, width_px: float, size_px: int, *, max_lines: int) -> list[str]:
    """Break a text into lines that fit; the last one is shortened if it must be."""
    lines: list[str] = []
    rest = readable(text).split()
    while rest and len(lines) < max_lines - 1:
        count = 1
        while count < len(rest) and (
            font(size_px).getlength(" ".join(rest[: count + 1])) <= width_px
        ):
            count += 1
        lines.append(shorten(" ".join(rest[:count]), width_px, size_px))
        rest = rest[count:]
    return [*lines, shorten(" ".join(rest), width_px, size_px)] if rest else lines


def dot(radius_px: int) -> NDArray[np.int64]:
    """Offsets (K, 2) of the pixels of a filled circle."""
    y, x = np.mgrid[-radius_px : radius_px + 1, -radius_px : radius_px + 1]
    inside = x**2 + y**2 <= radius_px**2 + 0.25 * radius_px
    return np.stack([x[inside], y[inside]], axis=1)


def stamp_dots(
    image: NDArray[np.uint8], at_px: NDArray[np.int64], colour: Colour, *, radius_px: int
) -> None:
    """Draw filled circles of one colour into an (H, W, 3) image; those outside are left out."""
    height, width = image.shape[:2]
    for dx, dy in dot(radius_px):
        x, y = at_px[:, 0] + dx, at_px[:, 1] + dy
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        image[y[inside], x[inside]] = colour


def _cut(text: str, keep: int) -> str:
    head = (keep + 1) // 2
    return f"{text[:head]}...{text[len(text) - (keep - head) :]}"
