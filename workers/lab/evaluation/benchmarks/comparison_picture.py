"""Comparison picture: frames side by side, bird's-eye view above, range image below."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from workers.lab.evaluation.benchmarks.bench_simulation import SensorFrame, range_image

_SIDE_PX: Final = 620
_HALF_M: Final = 45.0
_IMAGE_PX: Final = 128
_TEXT_PX: Final = 22
_INK: Final = (235, 238, 242)
_BACK: Final = (16, 18, 24)


def draw_side_by_side(frames: Sequence[tuple[str, SensorFrame]]) -> Image.Image:
    """Draw frames in a row, each under its name."""
    width, height = _SIDE_PX * len(frames), _TEXT_PX + _SIDE_PX + _IMAGE_PX
    picture = Image.new("RGB", (width, height), _BACK)
    pen = ImageDraw.Draw(picture)
    for place, (name, seen) in enumerate(frames):
        left = place * _SIDE_PX
        pen.text((left + 8, 5), name, fill=_INK)
        picture.paste(Image.fromarray(_above(seen)), (left, _TEXT_PX))
        ranges = Image.fromarray(_coloured(range_image(seen)))
        size = (_SIDE_PX - 4, _IMAGE_PX)
        picture.paste(ranges.resize(size, Image.Resampling.BOX), (left, _TEXT_PX + _SIDE_PX))
    return picture


def _above(seen: SensorFrame) -> NDArray[np.uint8]:
    """Draw a bird's-eye view: colour is height, of the highest point in a pixel."""
    scale = _SIDE_PX / (2 * _HALF_M)
    column = ((seen.points_m[:, 0] + _HALF_M) * scale).astype(np.int64)
    row = ((_HALF_M - seen.points_m[:, 1]) * scale).astype(np.int64)
    inside = (column >= 0) & (column < _SIDE_PX) & (row >= 0) & (row < _SIDE_PX)
    picture = np.full((_SIDE_PX, _SIDE_PX, 3), _BACK, dtype=np.uint8)
    order = np.argsort(seen.points_m[inside, 2], kind="stable")
    height = np.clip((seen.points_m[inside, 2] + 2.2) / 5.0, 0.0, 1.0)
    picture[row[inside][order], column[inside][order]] = _ramp(height)[order]
    return picture


def _coloured(ranges: NDArray[np.float32]) -> NDArray[np.uint8]:
    colours = _ramp(np.clip(np.log(np.maximum(ranges, 2.0) / 2.0) / np.log(40.0), 0.0, 1.0))
    colours[ranges == 0] = _BACK
    return colours


def _ramp(share: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Map 0 to 1 to a colour ramp from violet over green to yellow."""
    stops = np.array(
        [(90, 70, 200), (40, 130, 190), (50, 180, 120), (170, 210, 70), (250, 230, 90)]
    )
    at = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(share, at, stops[:, k]) for k in range(3)], axis=-1).astype(np.uint8)
