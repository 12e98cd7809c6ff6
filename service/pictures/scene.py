"""Pictures of a scored scene: from above in the colours of the method, and on the camera image."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState, TrackRecord
from schemas.overlay import Overlay
from schemas.score import SceneScore, shown_tracks
from schemas.task import Outcome, task_named
from service.pictures.above import draw_above
from service.pictures.camera import draw_camera
from service.pictures.reasons import draw_reasons
from service.pictures.style import (
    BACKGROUND,
    GRID,
    PANEL,
    SOFT_TEXT,
    TEXT,
    WITNESS_BOXES,
    colours_of,
    font,
    inks_of,
    meaning,
    shorten,
)
from service.pictures.tiles import draw_track
from service.pictures.title import Title, labels_of, title_of
from service.pictures.view import View

__all__ = ["draw_camera", "draw_scene"]

WIDTH_PX: Final = 1720
HEIGHT_PX: Final = 1250
_ABOVE_PX: Final = 1140
_MARGIN_PX: Final = 18
_TOP_PX: Final = 92
_ROWS: Final = 3
_LEGEND_ROWS: Final = 10
_LEGEND_PX: Final = 24


def draw_scene(
    score: SceneScore, overlay: Overlay, *, frame: int | None = None, title: Title | None = None
) -> Image.Image:
    """Draw a scene from above, with the reasons for its score.

    The large view shows one frame. Next to it are the strongest tracks at their begin, their
    strongest moment and their end, the legend with shares, and the reasons.

    Args:
        score: Record of the scene.
        overlay: Overlay of the scene.
        frame: Index of the frame to show; by default the one with the strongest evidence.
        title: Rank and name of the scene; by default its name alone.

    Raises:
        ValueError: If the overlay is of another scene, or has no such frame.
    """
    if overlay.scene_id != score.scene_id:
        raise ValueError(f"overlay is of {overlay.scene_id}, the record of {score.scene_id}")
    if frame is None:
        frame = strongest_frame(score, overlay)
    if not 0 <= frame < len(overlay):
        raise ValueError(f"no frame {frame}: scene has frames 0 to {len(overlay) - 1}")
    image = Image.new("RGB", (WIDTH_PX, HEIGHT_PX), BACKGROUND)
    draw = ImageDraw.Draw(image)
    _draw_header(draw, score, overlay, frame, title or title_of(score))
    view = View(frame, (0.0, 0.0), _half_m(score), _ABOVE_PX)
    image.paste(draw_above(overlay, view, labels=labels_of(score)), (_MARGIN_PX, _TOP_PX))
    right, bottom = _MARGIN_PX + _ABOVE_PX, _TOP_PX + _ABOVE_PX
    draw.rectangle((_MARGIN_PX, _TOP_PX, right, bottom), outline=GRID)
    _draw_side(image, score, overlay, frame)
    return image


def strongest_frame(score: SceneScore, overlay: Overlay) -> int:
    """Find the frame of the strongest instance of the strongest track; else the middle one."""
    return frame_of(score.tracks[0], overlay) if score.tracks else len(overlay) // 2


def frame_of(track: TrackRecord, overlay: Overlay) -> int:
    """Find the frame in which a track has its strongest instance."""
    return int(np.argmin(np.abs(overlay.stamps_ns - track.strongest.stamp_ns)))


def _half_m(score: SceneScore) -> float:
    """Return half of the view's side, metres: 30 to 80, to show the strongest tracks."""
    reach_m = max(
        (track.strongest.range_m for track in shown_tracks(score, most=_ROWS)), default=0.0
    )
    return float(np.clip(1.15 * reach_m + 5.0, 30.0, 80.0))


def _draw_header(
    draw: ImageDraw.ImageDraw, score: SceneScore, overlay: Overlay, frame: int, title: Title
) -> None:
    draw.text((_MARGIN_PX, 10), f"{score.score:.3f}", fill=TEXT, font=font(52))
    draw.text((_MARGIN_PX + 2, 64), "score", fill=SOFT_TEXT, font=font(15))
    left = _MARGIN_PX + 160
    width = WIDTH_PX - left - _MARGIN_PX
    draw.text((left, 8), shorten(title.place, width, 24), fill=TEXT, font=font(24))
    draw.text((left, 40), shorten(score.scene_id, width, 15), fill=SOFT_TEXT, font=font(15))
    start = datetime.fromtimestamp(score.start_ns / NS_PER_S, tz=UTC)
    at_s = (int(overlay.stamps_ns[frame]) - score.start_ns) / NS_PER_S
    span_s = (score.end_ns - score.start_ns) / NS_PER_S
    state = "" if score.state is SceneState.SCORED else f"{score.state.value.replace('_', ' ')} | "
    facts = (
        f"{state}{score.vehicle} | {start:%Y-%m-%d %H:%M:%S} UTC | {score.frames} frames in "
        f"{span_s:.1f} s, shown: frame {frame} at {at_s:.1f} s | "
        f"odometry {score.odometry.state.value}, {score.odometry.distance_m:.1f} m driven"
    )
    draw.text((left, 62), shorten(facts, width, 17), fill=SOFT_TEXT, font=font(17))


def _draw_side(image: Image.Image, score: SceneScore, overlay: Overlay, frame: int) -> None:
    draw = ImageDraw.Draw(image)
    left = 2 * _MARGIN_PX + _ABOVE_PX
    width = WIDTH_PX - left - _MARGIN_PX
    y = _TOP_PX
    for track in shown_tracks(score, most=_ROWS):
        y = draw_track(image, overlay, track, left=left, top=y, width=width)
    if not score.tracks:
        draw.text((left, y), "no contradiction in this scene", fill=SOFT_TEXT, font=font(18))
        y += 40
    witnessed = _witnessed(score, overlay, frame)
    legend = len(_named(score)) + len(witnessed) + 1
    bottom = HEIGHT_PX - _MARGIN_PX - _LEGEND_PX * legend
    draw_reasons(draw, score, left=left, top=y, width=width, bottom=bottom)
    _draw_legend(draw, score, witnessed, left=left, width=width)


def _draw_legend(
    draw: ImageDraw.ImageDraw,
    score: SceneScore,
    witnessed: Sequence[Outcome],
    *,
    left: int,
    width: int,
) -> None:
    """Draw the legend: each colour with its share of the compared points above the ground."""
    task = task_named(score.task)
    colours = colours_of(task)
    named = _named(score)
    top = HEIGHT_PX - _MARGIN_PX - (len(named) + len(witnessed)) * _LEGEND_PX - 14
    draw.rectangle((left, top, left + width, HEIGHT_PX - _MARGIN_PX), fill=PANEL)
    of_which = "off ground" if task.of_things else "of compared"
    for row, outcome in enumerate(named):
        y = top + 8 + _LEGEND_PX * row
        draw.rectangle((left + 10, y + 3, left + 26, y + 17), fill=colours[outcome.code])
        share = (
            f"{1 - score.compared_share:.1%} of all"
            if outcome.code == task.not_compared
            else f"{score.nonground_points[outcome.name]:.2%} {of_which}"
        )
        draw.text((left + 36, y), meaning(outcome, task), fill=TEXT, font=font(15))
        draw.text((left + width - 10, y), share, fill=SOFT_TEXT, font=font(15), anchor="ra")
    for row, kind in enumerate(witnessed, start=len(named)):
        y = top + 8 + _LEGEND_PX * row
        draw.rectangle((left + 10, y + 3, left + 26, y + 17), outline=inks_of(task)[kind.code])
        draw.text((left + 36, y), WITNESS_BOXES, fill=TEXT, font=font(15))


def _witnessed(score: SceneScore, overlay: Overlay, frame: int) -> list[Outcome]:
    """Return the outcome of the witness alone, if a box in the picture is of that kind."""
    codes = set(overlay.instance_kind[overlay.instances_of(frame)].tolist())
    named = {track.kind for track in shown_tracks(score, most=_ROWS)}
    kinds = (kind for kind in task_named(score.task).kinds if kind.of_witness)
    return [kind for kind in kinds if kind.code in codes or kind.name in named]


def _named(score: SceneScore) -> list[Outcome]:
    """Return the outcomes that fit the legend, by code: of many classes the commonest."""
    task, shares = task_named(score.task), score.nonground_points
    common = sorted(task.compared(), key=lambda outcome: (-shares[outcome.name], outcome.code))
    shown = sorted(common[: _LEGEND_ROWS - 1], key=lambda outcome: outcome.code)
    return [*shown, task.outcomes[task.not_compared]]
