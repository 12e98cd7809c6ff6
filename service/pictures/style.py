"""Colours, fonts and marks shared by all pictures of scenes."""

from collections.abc import Sequence
from colorsys import hsv_to_rgb
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import ImageFont

from schemas.task import Outcome, Task

Colour = tuple[int, int, int]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

BACKGROUND: Final[Colour] = (16, 18, 22)
PANEL: Final[Colour] = (26, 29, 35)
GRID: Final[Colour] = (52, 57, 66)
TEXT: Final[Colour] = (236, 238, 242)
SOFT_TEXT: Final[Colour] = (160, 166, 178)

_NOT_COMPARED: Final[Colour] = (110, 110, 110)
_TWO_CLASSES: Final = ((34, 139, 34), (225, 225, 0), (178, 34, 34), (65, 105, 225))
"""The paper's four colours (section III-C, figures). Green: both streams label the commonest class.
Blue: both label the second class. Yellow: the supervised stream alone labels it. Red: the
self-supervised stream alone labels it.
"""

WITNESS_INK: Final[Colour] = (232, 130, 250)
"""Colour of boxes and texts of motion that only the witness sees; its points are green."""

WITNESS_BOXES: Final = "boxes: dynamic by the witness alone"
"""Entry of a legend for boxes in that colour."""

_UNITS: Final = frozenset(("m", "m/s", "s", "%"))
"""Units that stay on the line of their number."""

_MORE: Final = "..."
_LIGHTER: Final = {(65, 105, 225): (105, 145, 255), (178, 34, 34): (255, 84, 84)}


def colours_of(task: Task) -> dict[int, Colour]:
    """Return the colour of each outcome of a task, by code.

    For two classes these are the paper's. For more, agreements have cold colours, and
    contradictions warm ones.
    """
    if len(task.classes) == 2:
        return dict(enumerate((*_TWO_CLASSES, _NOT_COMPARED)))
    agreed = [outcome for outcome in task.compared() if not outcome.contradicts]
    contradicting = [outcome for outcome in task.compared() if outcome.contradicts]
    colours = {task.not_compared: _NOT_COMPARED}
    for outcomes, (first, last), value in (
        (agreed, (130, 270), 0.7),
        (contradicting, (60, -40), 0.9),
    ):
        for hue_deg, outcome in zip(np.linspace(first, last, len(outcomes)), outcomes, strict=True):
            red, green, blue = hsv_to_rgb(hue_deg % 360 / 360, 0.8, value)
            colours[outcome.code] = (round(255 * red), round(255 * green), round(255 * blue))
    return colours


def inks_of(task: Task) -> dict[int, Colour]:
    """Return colours for lines and texts: the paper's blue and red, lighter on a dark background.

    Lines about points that both streams label static come from the witness.
    """
    inks = {code: _LIGHTER.get(colour, colour) for code, colour in colours_of(task).items()}
    witnessed = {kind.code: WITNESS_INK for kind in task.kinds if kind.of_witness}
    return inks | witnessed


def draw_order(task: Task) -> tuple[Outcome, ...]:
    """Return the outcomes in drawing order: contradictions last, so that they cover the others."""
    agreed = (outcome for outcome in task.compared() if not outcome.contradicts)
    contradicting = (outcome for outcome in task.compared() if outcome.contradicts)
    return (task.outcomes[task.not_compared], *agreed, *contradicting)


def meaning(outcome: Outcome, task: Task) -> str:
    """Describe an outcome in words."""
    if outcome.code == task.not_compared:
        return "not compared"
    if not outcome.contradicts:
        return f"both {outcome.semantic}"
    if len(task.classes) > 2:
        return f"supervised {outcome.semantic}, self-supervised {outcome.predictive}"
    second = task.classes[1]
    stream = "supervised" if outcome.semantic == second else "self-supervised"
    return f"{stream} stream alone: {second}"


@lru_cache(maxsize=16)
def font(size_px: int) -> Font:
    """Return Pillow's own scalable font, so that none has to be installed."""
    return ImageFont.load_default(size=size_px)


def readable(text: str) -> str:
    """Replace characters that the built-in font has no glyphs for."""
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
    """Break a text into lines that fit; surplus text is cut after a word or a remark."""
    lines: list[str] = []
    rest = _with_units(readable(text).split())
    while rest and len(lines) < max_lines:
        last = len(lines) == max_lines - 1
        count = _words_that_fit(rest, width_px, size_px)
        if last and count < len(rest):
            count = _words_that_fit(rest, width_px, size_px, end=_MORE)
            line = " ".join(_whole_remarks(rest[:count])).rstrip(",;") + _MORE
        else:
            line = " ".join(rest[:count])
        lines.append(shorten(line, width_px, size_px))
        rest = rest[count:]
    return lines


def _with_units(words: Sequence[str]) -> list[str]:
    """Join each number with its unit."""
    joined: list[str] = []
    for word in words:
        if joined and word.rstrip(",;:") in _UNITS and joined[-1][-1].isdigit():
            joined[-1] += f" {word}"
        else:
            joined.append(word)
    return joined


def _whole_remarks(words: Sequence[str]) -> Sequence[str]:
    """Remove an incomplete remark, or a heading without content, from the end of a cut line.

    A line that is one long remark keeps its words.
    """
    ends = [place for place, word in enumerate(words, start=1) if word.endswith((",", ";"))]
    count = ends[-1] if ends and 2 * ends[-1] >= len(words) else len(words)
    while count and words[count - 1].endswith(":"):
        count -= 1
    return words[:count]


def _words_that_fit(words: Sequence[str], width_px: float, size_px: int, *, end: str = "") -> int:
    """Return how many words fit on a line, at least one."""
    count = 1
    while count < len(words) and (
        font(size_px).getlength(" ".join(words[: count + 1]) + end) <= width_px
    ):
        count += 1
    return count


def dot(radius_px: int) -> NDArray[np.int64]:
    """Return the offsets (K, 2) of the pixels of a filled circle."""
    y, x = np.mgrid[-radius_px : radius_px + 1, -radius_px : radius_px + 1]
    inside = x**2 + y**2 <= radius_px**2 + 0.25 * radius_px
    return np.stack([x[inside], y[inside]], axis=1)


def stamp_dots(
    image: NDArray[np.uint8], at_px: NDArray[np.int64], colour: Colour, *, radius_px: int
) -> None:
    """Draw filled circles of one colour into an (H, W, 3) image; pixels outside are left out."""
    height, width = image.shape[:2]
    for dx, dy in dot(radius_px):
        x, y = at_px[:, 0] + dx, at_px[:, 1] + dy
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        image[y[inside], x[inside]] = colour


def _cut(text: str, keep: int) -> str:
    head = (keep + 1) // 2
    return f"{text[:head]}{_MORE}{text[len(text) - (keep - head) :]}"
