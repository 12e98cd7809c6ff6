"""Tiles of a track: at its begin, its strongest moment and its end, from above.

The three tiles show one place of the world if the way of the track fits into them. A thing that
moves then lies elsewhere in each of them, and one that stands does not.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.overlay import Overlay
from service.pictures.above import draw_above
from service.pictures.style import GRID, PANEL, SOFT_TEXT, TEXT, font, inks_of, shorten
from service.pictures.view import View, to_frame

TILE_PX: Final = 168

_MOST_WIDER: Final = 1.6
"""Factor by which a window grows at most, so that a way fits: its box stays large enough to see."""


def draw_track(
    image: Image.Image, overlay: Overlay, track: TrackRecord, *, left: int, top: int, width: int
) -> int:
    """Draw one track at its begin, its strongest moment and its end.

    Returns:
        Row of pixels below it.
    """
    draw = ImageDraw.Draw(image)
    ink = inks_of(overlay.task)[overlay.task.kind(track.kind).code]
    best = track.strongest
    what = f"{track.track_id + 1} {track.class_name or 'object'}, strength {track.strength:.2f}"
    sure = (
        f"supervised {best.semantic_confidence:.0%} sure, "
        f"self-supervised {best.predictive_confidence:.0%}"
    )
    room = width - draw.textlength(sure, font(14)) - 12
    draw.text((left, top), shorten(what, room, 16), fill=ink, font=font(16))
    draw.text((left + width, top + 2), sure, fill=SOFT_TEXT, font=font(14), anchor="ra")
    top += 22
    members = np.flatnonzero(overlay.instance_track == track.track_id)
    if not len(members):
        return top
    stamps_ns = overlay.stamps_ns[overlay.instance_frame[members]]
    strongest = members[int(np.argmin(np.abs(stamps_ns - track.strongest.stamp_ns)))]
    half_m = float(np.clip(1.6 * track.strongest.size_m[0], 4.0, 16.0))
    gap = (width - 3 * TILE_PX) // 2
    for column, view in enumerate(views_of(overlay, moments_of(members, strongest), half_m)):
        tile = draw_above(overlay, view, dot_px=2, background=False, rings=False)
        at = (left + column * (TILE_PX + gap), top)
        image.paste(tile, at)
        draw.rectangle((*at, at[0] + TILE_PX, at[1] + TILE_PX), outline=GRID)
        seconds = (int(overlay.stamps_ns[view.frame]) - int(overlay.stamps_ns[0])) / NS_PER_S
        draw.rectangle((at[0] + 1, at[1] + 1, at[0] + 42, at[1] + 20), fill=PANEL)
        draw.text((at[0] + 5, at[1] + 3), f"{seconds:.1f} s", fill=TEXT, font=font(14))
    return top + TILE_PX + 12


def moments_of(members: NDArray[np.intp], strongest: int) -> list[int]:
    """Return indices of begin, strongest moment and end, distinct in a track of three frames."""
    first, last = int(members[0]), int(members[-1])
    between = strongest if strongest not in (first, last) else int(members[len(members) // 2])
    return sorted({first, between, last})


def views_of(overlay: Overlay, instances: Sequence[int], half_m: float) -> list[View]:
    """Return the window of each instance: one place of the world, else each around its box.

    Args:
        overlay: Overlay of the scene.
        instances: Instances of one track, in order, one or more.
        half_m: Half of a window's side, metres; a window of one place may be a little larger.
    """
    frames = [int(overlay.instance_frame[each]) for each in instances]
    boxes = overlay.instance_boxes[list(instances)]
    way_m = np.concatenate(
        [
            to_frame(overlay, box[None, :3], of=frame, to=frames[0])
            for box, frame in zip(boxes, frames, strict=True)
        ]
    )
    low, high = way_m.min(axis=0), way_m.max(axis=0)
    needed_m = float((high - low)[:2].max() / 2 + boxes[:, 3:5].max() / 2 + 1.0)
    if needed_m > _MOST_WIDER * half_m:
        centres = boxes[:, :2]
    else:
        half_m, middle = max(half_m, needed_m), (low + high)[None] / 2
        centres = np.concatenate(
            [to_frame(overlay, middle, of=frames[0], to=frame)[:, :2] for frame in frames]
        )
    return [
        View(frame, (float(x), float(y)), half_m, TILE_PX)
        for frame, (x, y) in zip(frames, centres, strict=True)
    ]
