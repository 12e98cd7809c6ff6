"""Top views of evaluated frames: true positives, misses and false positives of a stream."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from service.output_files import need_folder, save_picture
from service.pictures.above import draw_ego, draw_rings, draw_scale
from service.pictures.style import (
    BACKGROUND,
    GRID,
    SOFT_TEXT,
    TEXT,
    Colour,
    font,
    shorten,
    stamp_dots,
)
from service.pictures.view import View

if TYPE_CHECKING:
    from workers.lab.evaluation.motion.motion import EvaluatedFrame

HALF_M: Final = 80.0
SIZE_PX: Final = 1200
_BAR_PX: Final = 64
_SHEET_COLUMNS: Final = 5
_SHEET_TILE_PX: Final = 640

_STATIC: Final[Colour] = (44, 58, 50)
_UNKNOWN_TRUTH: Final[Colour] = (92, 78, 52)
_FOUND: Final[Colour] = (92, 132, 255)
_UNCONFIRMED: Final[Colour] = (86, 196, 220)
_MISSED: Final[Colour] = (250, 210, 40)
_FALSE: Final[Colour] = (255, 70, 70)


def draw_worst(
    folder: Path, frames: Sequence["EvaluatedFrame"], *, force: bool = False
) -> list[Path]:
    """Draw frames from above, one file for each and a sheet of all of them.

    Args:
        folder: Made if it does not exist; contains `worst.png` and `NN-….png`, worst first.
        frames: Worst first.
        force: Replace foreign files.

    Returns:
        The files, the sheet first.

    Raises:
        UsageError: If one cannot be written, or is a foreign file.
    """
    need_folder(folder, option="--pictures")
    pictures = [draw_judged(judged) for judged in frames]
    paths = [
        folder / f"{place:02d}-{judged.name.replace('/', '-')}.png"
        for place, judged in enumerate(frames, start=1)
    ]
    for picture, path in zip(pictures, paths, strict=True):
        save_picture(picture, path, option="--pictures", force=force)
    if not pictures:
        return []
    sheet = folder / "worst.png"
    save_picture(_sheet(pictures), sheet, option="--pictures", force=force)
    return [sheet, *paths]


def draw_judged(judged: "EvaluatedFrame") -> Image.Image:
    """Draw one evaluated frame: 80 m around, with the count of each colour."""
    view = View(0, (0.0, 0.0), HALF_M, SIZE_PX)
    near = np.hypot(judged.points_m[:, 0], judged.points_m[:, 1]) < HALF_M
    kinds = _kinds(judged)
    pixels = np.full((SIZE_PX, SIZE_PX, 3), BACKGROUND, dtype=np.uint8)
    at_px = np.floor(view.to_px(judged.points_m)).astype(np.int64)
    for _, colour, chosen, radius_px in kinds:
        stamp_dots(pixels, at_px[chosen], colour, radius_px=radius_px)
    above = Image.fromarray(pixels)
    draw = ImageDraw.Draw(above)
    draw_rings(draw, view)
    draw_ego(draw, view)
    draw_scale(draw, view, ring_names=True)

    image = Image.new("RGB", (SIZE_PX, SIZE_PX + _BAR_PX), BACKGROUND)
    image.paste(above, (0, _BAR_PX))
    draw = ImageDraw.Draw(image)
    draw.text((12, 6), shorten(judged.name, SIZE_PX - 24, 22), fill=TEXT, font=font(22))
    left = 12
    for meaning, colour, chosen, _ in kinds:
        words = f"{meaning} {int((chosen & near).sum())}"
        draw.rectangle((left, 40, left + 14, 54), fill=colour)
        draw.text((left + 20, 37), words, fill=SOFT_TEXT, font=font(16))
        left += 44 + int(draw.textlength(words, font(16)))
    return image


def _kinds(judged: "EvaluatedFrame") -> list[tuple[str, Colour, NDArray[np.bool_], int]]:
    """Return name, colour, mask and dot radius of each kind of point."""
    from schemas.labels import MotionLabel
    from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC, TRUTH_STATIC, TRUTH_UNKNOWN

    called = judged.labels == MotionLabel.DYNAMIC
    moves, stands = judged.truth == TRUTH_DYNAMIC, judged.truth == TRUTH_STATIC
    confirmed = called if judged.confirmed is None else judged.confirmed
    return [
        ("static", _STATIC, stands & ~called, 0),
        ("of unknown truth", _UNKNOWN_TRUTH, judged.truth == TRUTH_UNKNOWN, 0),
        ("found", _FOUND, moves & called & confirmed, 1),
        ("found, not confirmed", _UNCONFIRMED, moves & called & ~confirmed, 1),
        ("missed", _MISSED, moves & ~called, 2),
        ("called dynamic, but static", _FALSE, stands & called, 2),
    ]


def _sheet(pictures: Sequence[Image.Image]) -> Image.Image:
    rows = -(-len(pictures) // _SHEET_COLUMNS)
    columns = min(len(pictures), _SHEET_COLUMNS)
    tall = _SHEET_TILE_PX * (SIZE_PX + _BAR_PX) // SIZE_PX
    sheet = Image.new("RGB", (columns * _SHEET_TILE_PX, rows * tall), GRID)
    for place, picture in enumerate(pictures):
        tile = picture.resize((_SHEET_TILE_PX - 4, tall - 4), Image.Resampling.BOX)
        sheet.paste(tile, (place % _SHEET_COLUMNS * _SHEET_TILE_PX, place // _SHEET_COLUMNS * tall))
    return sheet
