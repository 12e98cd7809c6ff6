"""Small picture of a scene for lists: its strongest track from above, with the car."""

from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.pictures.above import draw_above
from service.pictures.scene import strongest_frame
from service.pictures.style import BACKGROUND, SOFT_TEXT, TEXT, font
from service.pictures.view import View

WIDTH_PX: Final = 352
HEIGHT_PX: Final = 264
"""Pixels of a thumbnail, twice what a page shows, for screens of high density."""

_MARGIN_M: Final = 7.0
"""Least distance of car and track from the edge, metres."""

_LEAST_HALF_M: Final = 12.0
_WITHOUT_TRACK_HALF_M: Final = 40.0
_CORNER_PX: Final = 9


def draw_thumbnail(score: SceneScore, overlay: Overlay) -> Image.Image:
    """Draw the frame of the strongest track, with white corners around it.

    Args:
        score: Record of the scene.
        overlay: Overlay of the scene.

    Returns:
        (HEIGHT_PX, WIDTH_PX) picture in RGB.

    Raises:
        ValueError: If the overlay is of another scene.
    """
    if overlay.scene_id != score.scene_id:
        raise ValueError(f"overlay is of {overlay.scene_id}, the record of {score.scene_id}")
    view = _view(score, strongest_frame(score, overlay))
    image = draw_above(overlay, view, background=False, rings=False, scale=False)
    if score.tracks:
        _draw_corners(ImageDraw.Draw(image), score, view)
    top = (WIDTH_PX - HEIGHT_PX) // 2
    return image.crop((0, top, WIDTH_PX, top + HEIGHT_PX))


def draw_placeholder(words: str) -> Image.Image:
    """Draw a thumbnail of the same size with words in place of points."""
    image = Image.new("RGB", (WIDTH_PX, HEIGHT_PX), BACKGROUND)
    draw = ImageDraw.Draw(image)
    at = (WIDTH_PX / 2, HEIGHT_PX / 2)
    draw.text(at, words, fill=SOFT_TEXT, font=font(22), anchor="mm")
    return image


def _view(score: SceneScore, frame: int) -> View:
    """Return the smallest window with the car and the strongest track in the cropped picture."""
    if not score.tracks:
        return View(frame, (0.0, 0.0), _WITHOUT_TRACK_HALF_M, WIDTH_PX)
    x, y = (float(value) / 2 for value in score.tracks[0].strongest.centre_m[:2])
    half_m = max(_LEAST_HALF_M, abs(y) + _MARGIN_M, (abs(x) + _MARGIN_M) * WIDTH_PX / HEIGHT_PX)
    return View(frame, (x, y), half_m, WIDTH_PX)


def _draw_corners(draw: ImageDraw.ImageDraw, score: SceneScore, view: View) -> None:
    strongest = score.tracks[0].strongest
    ((x, y),) = view.to_px(np.array([strongest.centre_m[:2]]))
    half_px = np.hypot(*strongest.size_m[:2]) / 2 * view.px_per_m + 5
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            corner = (float(x + sign_x * half_px), float(y + sign_y * half_px))
            ends = (corner[0] - sign_x * _CORNER_PX, corner[1] - sign_y * _CORNER_PX)
            draw.line([(ends[0], corner[1]), corner, (corner[0], ends[1])], fill=TEXT, width=2)
