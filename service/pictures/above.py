"""Top view of a frame: points in the paper's colours, instances as boxes, tracks as lines."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from schemas.overlay import Overlay
from service.pictures.style import (
    BACKGROUND,
    GRID,
    SOFT_TEXT,
    TEXT,
    Colour,
    colours_of,
    draw_order,
    font,
    inks_of,
    stamp_dots,
)
from service.pictures.view import View, to_frame

_FINE: Final = 2
"""Supersampling factor, so that lines at any angle are smooth."""

_AGREED_GROUND: Final[Colour] = (20, 62, 28)
_NOT_COMPARED: Final[Colour] = (62, 64, 70)
_PAST_AND_FUTURE: Final[Colour] = (30, 42, 34)
_BACKGROUND_CODE: Final = 0
"""Code of the agreement where both streams label a task's first class, drawn as background."""

_EGO: Final[Colour] = (245, 245, 245)


def draw_above(
    overlay: Overlay,
    view: View,
    *,
    labels: Sequence[tuple[int, str]] = (),
    dot_px: int = 1,
    background: bool = True,
    rings: bool = True,
    scale: bool = True,
) -> Image.Image:
    """Draw one frame from above.

    Args:
        overlay: Overlay of the scene.
        view: Frame and window to draw.
        labels: Track numbers and texts, drawn next to their boxes where there is room.
        dot_px: Radius of contradicting points; agreeing ones are smaller.
        background: Draw static points of the other frames faintly.
        rings: Draw rings of distance from the sensor.
        scale: Draw a scale bar.
    """
    fine = View(view.frame, view.centre_m, view.half_m, view.size_px * _FINE)
    pixels = np.full((fine.size_px, fine.size_px, 3), BACKGROUND, dtype=np.uint8)
    if background:
        _draw_other_frames(pixels, overlay, fine)
    _draw_points(pixels, overlay, fine, dot_px=dot_px)
    image = Image.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    if rings:
        draw_rings(draw, fine)
    _draw_paths(draw, overlay, fine)
    _draw_boxes(draw, overlay, fine)
    draw_ego(draw, fine)
    image = image.resize((view.size_px, view.size_px), Image.Resampling.BOX)
    draw = ImageDraw.Draw(image)
    if scale:
        draw_scale(draw, view, ring_names=rings)
    _draw_labels(draw, overlay, view, labels)
    return image


def _inside(view: View, at_px: NDArray[np.float64], margin_px: int = 4) -> NDArray[np.bool_]:
    low, high = -margin_px, view.size_px + margin_px
    return np.asarray(((at_px >= low) & (at_px < high)).all(axis=1))


def _whole(at_px: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.floor(at_px).astype(np.int64)


def _draw_other_frames(pixels: NDArray[np.uint8], overlay: Overlay, view: View) -> None:
    """Draw static points of the other frames, transformed by the poses."""
    for frame in range(len(overlay)):
        if frame == view.frame:
            continue
        part = overlay.points_of(frame)
        keep = overlay.has_position(frame) & ~overlay.ground_mask[part]
        keep &= overlay.agreements[part] == _BACKGROUND_CODE
        points_m = to_frame(overlay, overlay.points_m(frame)[keep], of=frame, to=view.frame)
        at_px = view.to_px(points_m)
        stamp_dots(pixels, _whole(at_px[_inside(view, at_px)]), _PAST_AND_FUTURE, radius_px=0)


def _draw_points(pixels: NDArray[np.uint8], overlay: Overlay, view: View, *, dot_px: int) -> None:
    part = overlay.points_of(view.frame)
    at_px = view.to_px(overlay.points_m(view.frame))
    shown = overlay.has_position(view.frame) & _inside(view, at_px)
    agreements, ground = overlay.agreements[part], overlay.ground_mask[part]

    def stamp(chosen: NDArray[np.bool_], colour: Colour, radius_px: int) -> None:
        stamp_dots(pixels, _whole(at_px[shown & chosen]), colour, radius_px=radius_px)

    colours = colours_of(overlay.task)
    usual = agreements == _BACKGROUND_CODE
    stamp(agreements == overlay.task.not_compared, _NOT_COMPARED, 0)
    stamp(usual & ground, _AGREED_GROUND, 0)
    stamp(usual & ~ground, colours[_BACKGROUND_CODE], dot_px)
    for outcome in draw_order(overlay.task)[2:]:
        radius_px = dot_px + int(outcome.contradicts)
        stamp(agreements == outcome.code, colours[outcome.code], radius_px)


def draw_rings(draw: ImageDraw.ImageDraw, view: View) -> None:
    """Draw rings of distance from the sensor."""
    (origin,) = view.to_px(np.zeros((1, 2)))
    for range_m in _ring_ranges(view):
        radius = range_m * view.px_per_m
        box = [origin[0] - radius, origin[1] - radius, origin[0] + radius, origin[1] + radius]
        draw.ellipse(box, outline=GRID, width=_FINE)


def _ring_ranges(view: View) -> list[int]:
    step_m = 10 if view.half_m <= 45 else 20
    return list(range(step_m, int(view.half_m * 1.5) + 1, step_m))


def _draw_paths(draw: ImageDraw.ImageDraw, overlay: Overlay, view: View) -> None:
    """Draw the path over the scene of each track that is in this frame."""
    for instance in overlay.instances_of(view.frame):
        same = np.flatnonzero(overlay.instance_track == overlay.instance_track[instance])
        centres_m = np.concatenate(
            [
                to_frame(
                    overlay,
                    overlay.instance_boxes[other : other + 1, :3],
                    of=int(overlay.instance_frame[other]),
                    to=view.frame,
                )
                for other in same
            ]
        )
        path_px = [(float(x), float(y)) for x, y in view.to_px(centres_m)]
        if len(path_px) > 1:
            draw.line(path_px, fill=_ink(overlay, int(instance)), width=_FINE, joint="curve")


def _draw_boxes(draw: ImageDraw.ImageDraw, overlay: Overlay, view: View) -> None:
    for instance in overlay.instances_of(view.frame):
        corners_px = _box_px(overlay, int(instance), view)
        draw.polygon(corners_px, outline=_ink(overlay, int(instance)), width=2 * _FINE)


def _box_px(overlay: Overlay, instance: int, view: View) -> list[tuple[float, float]]:
    """Return the corners of a box in pixels, seen from above, with a small margin."""
    x, y, _, length, width, _, yaw = (float(value) for value in overlay.instance_boxes[instance])
    margin_m = 0.3
    along = np.array([np.cos(yaw), np.sin(yaw)]) * (length / 2 + margin_m)
    across = np.array([-np.sin(yaw), np.cos(yaw)]) * (width / 2 + margin_m)
    corners_m = np.array([x, y]) + np.stack(
        [along + across, along - across, -along - across, across - along]
    )
    return [(float(px), float(py)) for px, py in view.to_px(corners_m)]


def _ink(overlay: Overlay, instance: int) -> Colour:
    return inks_of(overlay.task)[int(overlay.instance_kind[instance])]


def draw_ego(draw: ImageDraw.ImageDraw, view: View) -> None:
    """Draw the position and heading of the sensor."""
    nose_m = np.array([[1.6, 0.0], [-1.2, 0.9], [-0.6, 0.0], [-1.2, -0.9]])
    draw.polygon([(float(x), float(y)) for x, y in view.to_px(nose_m)], fill=_EGO)


def _draw_labels(
    draw: ImageDraw.ImageDraw, overlay: Overlay, view: View, labels: Sequence[tuple[int, str]]
) -> None:
    """Draw texts next to boxes, in their order; one without room is left out."""
    size_px = 15
    taken: list[tuple[float, float, float, float]] = []
    here = overlay.instances_of(view.frame)
    for track, words in labels:
        for instance in here[overlay.instance_track[here] == track]:
            box = np.array(_box_px(overlay, int(instance), view))
            low, high = box.min(axis=0), box.max(axis=0)
            wide, tall = draw.textlength(words, font(size_px)) + 8, size_px + 6
            for left, top in (
                (high[0] + 4, low[1] - tall / 2),
                (low[0] - wide - 4, low[1] - tall / 2),
                ((low[0] + high[0] - wide) / 2, low[1] - tall - 3),
                ((low[0] + high[0] - wide) / 2, high[1] + 3),
            ):
                spot = (float(left), float(top), float(left + wide), float(top + tall))
                if _fits(spot, taken, view.size_px):
                    taken.append(spot)
                    ink = _ink(overlay, int(instance))
                    draw.rectangle(spot, fill=(10, 11, 14), outline=ink)
                    draw.text((spot[0] + 4, spot[1] + 2), words, fill=ink, font=font(size_px))
                    break


def _fits(
    spot: tuple[float, float, float, float],
    taken: Sequence[tuple[float, float, float, float]],
    size_px: int,
) -> bool:
    left, top, right, bottom = spot
    if left < 0 or top < 0 or right > size_px or bottom > size_px:
        return False
    return all(right < t[0] or left > t[2] or bottom < t[1] or top > t[3] for t in taken)


def draw_scale(draw: ImageDraw.ImageDraw, view: View, *, ring_names: bool) -> None:
    """Draw a scale bar of a round length, and the distances of the rings."""
    bar_m = next(m for m in (20, 10, 5, 2, 1, 0) if m * view.px_per_m <= view.size_px / 3)
    right, bottom = view.size_px - 14, view.size_px - 14
    left = right - bar_m * view.px_per_m
    draw.rectangle((left - 5, bottom - 20, right + 5, bottom + 5), fill=BACKGROUND)
    draw.line([(left, bottom), (right, bottom)], fill=TEXT, width=3)
    draw.text(((left + right) / 2, bottom - 4), f"{bar_m} m", fill=TEXT, font=font(13), anchor="ms")
    if not ring_names:
        return
    (origin,) = view.to_px(np.zeros((1, 2)))
    for range_m in _ring_ranges(view):
        at = float(origin[1]) + range_m * view.px_per_m
        if 0 < at < view.size_px - 30:
            draw.text(
                (origin[0] + 4, at),
                f"{range_m} m",
                fill=SOFT_TEXT,
                font=font(13),
                anchor="lb",
                stroke_width=3,
                stroke_fill=BACKGROUND,
            )
