"""Boxes of a frame's instances on a camera image, with the numbers of the picture from above."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import ImageDraw

from schemas.overlay import Overlay
from schemas.sights import Projection, corners_m
from service.pictures.style import BACKGROUND, Colour, font, inks_of

_SAMPLES: Final = 24
"""Points along an edge: a lens bends edges, and only their part inside the image is drawn."""

_EDGES: Final = np.array(
    [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
)
"""(12, 2) pairs of corners that differ in one direction."""

_LABEL_PX: Final = 18
_WIDTH_PX: Final = (2, 4)
"""Width of the lines of a box, and of one for which the image was chosen, pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraBox:
    """A box on an image.

    Attributes:
        lines_px: Runs of (K, 2) pixels along its edges, inside the image.
        ink: Colour of its kind of contradiction.
        label: Number and class of its track; empty for none.
        is_shown: Whether the image was chosen for its track; its lines are wider.
        is_of_witness: Whether only the witness labels it dynamic; its points have no colour of
            their own.
    """

    lines_px: tuple[NDArray[np.float64], ...]
    ink: Colour
    label: str
    is_shown: bool = False
    is_of_witness: bool = False


def boxes_of(
    overlay: Overlay,
    frame: int,
    view: Projection,
    *,
    labels: Sequence[tuple[int, str]],
    shown_track: int | None = None,
) -> list[CameraBox]:
    """Project the boxes of a frame's instances; one that is nowhere inside is left out.

    Args:
        overlay: The scene.
        frame: Index of the frame.
        view: The image.
        labels: Track numbers and texts, as for the picture from above.
        shown_track: Track for which the image was chosen.
    """
    named, inks = dict(labels), inks_of(overlay.task)
    of_witness = {kind.code for kind in overlay.task.kinds if kind.of_witness}
    boxes = []
    for instance in overlay.instances_of(frame):
        lines = _lines_px(corners_m(overlay.instance_boxes[instance]), view)
        if lines:
            track, kind = int(overlay.instance_track[instance]), overlay.instance_kind[instance]
            boxes.append(
                CameraBox(
                    lines_px=lines,
                    ink=inks[int(kind)],
                    label=named.get(track, ""),
                    is_shown=track == shown_track,
                    is_of_witness=int(kind) in of_witness,
                )
            )
    return boxes


def draw_boxes(draw: ImageDraw.ImageDraw, boxes: Sequence[CameraBox], *, scale: float) -> None:
    """Draw boxes and their labels, those without a label first."""
    for box in sorted(boxes, key=lambda each: bool(each.label)):
        for line in box.lines_px:
            at_px = [(float(x), float(y)) for x, y in line * scale]
            draw.line(at_px, fill=box.ink, width=_WIDTH_PX[box.is_shown], joint="curve")
    for box in boxes:
        if box.label:
            _draw_label(draw, box, scale=scale)


def _draw_label(draw: ImageDraw.ImageDraw, box: CameraBox, *, scale: float) -> None:
    """Draw the label above the box, or below it at the upper edge of the image."""
    at_px = np.concatenate(box.lines_px) * scale
    left, top, bottom = at_px[:, 0].min(), at_px[:, 1].min(), at_px[:, 1].max()
    wide, tall = draw.textlength(box.label, font(_LABEL_PX)) + 10, _LABEL_PX + 8
    y = top - tall - 4 if top - tall - 4 >= 0 else bottom + 4
    draw.rectangle((left, y, left + wide, y + tall), fill=BACKGROUND, outline=box.ink)
    draw.text((left + 5, y + 3), box.label, fill=box.ink, font=font(_LABEL_PX))


def _lines_px(corners: NDArray[np.float32], view: Projection) -> tuple[NDArray[np.float64], ...]:
    steps = np.linspace(0.0, 1.0, _SAMPLES)[None, :, None]
    begins, ends = corners[_EDGES[:, 0], None], corners[_EDGES[:, 1], None]
    points_m = (begins + (ends - begins) * steps).reshape(-1, 3).astype(np.float32)
    at_px, inside_mask = view.project(points_m)
    lines = []
    for edge, inside in zip(
        at_px.reshape(-1, _SAMPLES, 2), inside_mask.reshape(-1, _SAMPLES), strict=True
    ):
        runs = np.split(np.arange(_SAMPLES), np.flatnonzero(np.diff(inside)) + 1)
        lines += [edge[run] for run in runs if inside[run[0]] and len(run) > 1]
    return tuple(lines)
