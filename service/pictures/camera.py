"""Points of a frame drawn on the camera image, as in the paper's review."""

import io
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, UnidentifiedImageError

from schemas.arrays import Mask
from schemas.errors import PermanentError
from schemas.overlay import Overlay
from schemas.task import Task
from service.pictures.camera_boxes import CameraBox, draw_boxes
from service.pictures.style import (
    BACKGROUND,
    TEXT,
    WITNESS_BOXES,
    WITNESS_INK,
    colours_of,
    draw_order,
    font,
    meaning,
    shorten,
    stamp_dots,
)

DOT_PX: Final = 2
"""Radius of the filled circles, pixels, as in the paper's overlays."""

SMALL_DOT_PX: Final = 1
"""Radius where both streams label the commonest class, pixels: dense points would hide the image.
"""

MIN_WIDTH_PX: Final = 1600
"""Width to which smaller images are enlarged, pixels; else the circles would hide objects."""

_STRIP_PX: Final = 30
_TITLE_PX: Final = 20
_LINE_PX: Final = 28


class ImageUnreadableError(PermanentError):
    """The camera message contains no readable image."""


def draw_camera(
    image_bytes: bytes,
    overlay: Overlay,
    *,
    frame: int,
    at_px: NDArray[np.float64],
    inside_mask: Mask,
    boxes: Sequence[CameraBox] = (),
    title: Sequence[str] = (),
) -> Image.Image:
    """Draw the points and boxes of a frame on the camera image, contradictions on top.

    Args:
        image_bytes: JPEG or PNG as recorded.
        overlay: The scene.
        frame: Index of the frame to which the image belongs.
        at_px: (N, 2) pixel coordinates of that frame's points, right and down.
        inside_mask: (N,) true for points inside the image.
        boxes: Boxes of its instances, in pixels of the recorded image.
        title: Lines above the image.

    Returns:
        The image, at least 1600 pixels wide, with its points, below its title and above a strip
        that names the colours.

    Raises:
        ImageUnreadableError: If the bytes are not an image.
        ValueError: If the scene has no such frame, or the frame another number of points.
    """
    if not 0 <= frame < len(overlay):
        raise ValueError(f"no frame {frame}: scene has frames 0 to {len(overlay) - 1}")
    agreements = overlay.agreements[overlay.points_of(frame)]
    if not len(agreements) == len(at_px) == len(inside_mask):
        raise ValueError(
            f"frame {frame} has {len(agreements)} points, "
            f"got {len(at_px)} pixels and {len(inside_mask)} in the mask"
        )
    try:
        image = Image.open(io.BytesIO(image_bytes)).convert("RGB")
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise ImageUnreadableError(f"cannot read the camera image: {error}") from error
    scale = max(1.0, MIN_WIDTH_PX / image.width)
    if scale > 1.0:
        size = (MIN_WIDTH_PX, round(image.height * scale))
        image = image.resize(size, Image.Resampling.BICUBIC)
    pixels = np.array(image)
    seen = inside_mask & overlay.has_position(frame)
    colours = colours_of(overlay.task)
    for outcome in draw_order(overlay.task)[1:]:
        chosen = at_px[seen & (agreements == outcome.code)]
        stamp_dots(
            pixels,
            np.floor(chosen * scale).astype(np.int64),
            colours[outcome.code],
            radius_px=DOT_PX if outcome.code else SMALL_DOT_PX,
        )
    shown = Image.fromarray(pixels)
    draw_boxes(ImageDraw.Draw(shown), boxes, scale=scale)
    has_witness = any(box.is_of_witness for box in boxes)
    return _framed(shown, overlay.task, title, has_witness=has_witness)


def _framed(
    image: Image.Image, task: Task, title: Sequence[str], *, has_witness: bool
) -> Image.Image:
    """Put an image between its title and the legend of its colours."""
    above = _LINE_PX * len(title) + 10 if title else 0
    canvas = Image.new("RGB", (image.width, above + image.height + _STRIP_PX), BACKGROUND)
    canvas.paste(image, (0, above))
    draw = ImageDraw.Draw(canvas)
    for row, line in enumerate(title):
        words = shorten(line, image.width - 16, _TITLE_PX)
        draw.text((8, 6 + row * _LINE_PX), words, fill=TEXT, font=font(_TITLE_PX))
    left, top = 8.0, above + image.height + 7
    colours = colours_of(task)
    for outcome in draw_order(task)[1:]:
        words = meaning(outcome, task)
        draw.ellipse((left, top + 3, left + 11, top + 14), fill=colours[outcome.code])
        draw.text((left + 16, top), words, fill=TEXT, font=font(15))
        left += 16 + draw.textlength(words, font(15)) + 18
    if has_witness:
        draw.rectangle((left, top + 3, left + 11, top + 14), outline=WITNESS_INK)
        draw.text((left + 16, top), WITNESS_BOXES, fill=TEXT, font=font(15))
    return canvas
