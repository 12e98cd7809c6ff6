"""Reasons of a scene on its picture: all gates, and as many tracks as fit."""

from collections.abc import Sequence
from typing import Final

from PIL import ImageDraw

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState
from schemas.score import SceneScore
from schemas.task import task_named
from service.pictures.style import SOFT_TEXT, TEXT, Colour, font, inks_of, wrap

_LINE_PX: Final = 21
_SIZE_PX: Final = 16
_INDENT_PX: Final = 20
_FEWEST: Final = 2
"""Lines of a reason at least; more where all of them fit."""

_GATES: Final = (
    "odometry ",
    "recorded odometry ",
    "self-supervised stream ",
    "nothing was compared",
)
"""First words of reasons that are gates: they lower the score, or leave nothing to compare."""


def draw_reasons(
    draw: ImageDraw.ImageDraw, score: SceneScore, *, left: int, top: int, width: int, bottom: int
) -> None:
    """Draw the reasons; one about a track has its number, colour and strongest moment."""
    task = task_named(score.task)
    told: list[tuple[str, Colour, str]] = []
    gates: list[tuple[str, Colour, str]] = []
    for index, reason in enumerate(score.reasons):
        if index >= len(score.tracks) or not _tells_a_track(reason, score):
            gates.append(("-", SOFT_TEXT, reason))
            continue
        track = score.tracks[index]
        at_s = (track.strongest.stamp_ns - score.start_ns) / NS_PER_S
        ink = inks_of(task)[task.kind(track.kind).code]
        told.append((str(track.track_id + 1), ink, f"at {at_s:.1f} s: {reason}"))
    rows = [*told, *gates]
    wanted = [len(wrap(text, width - _INDENT_PX, _SIZE_PX, max_lines=99)) for _, _, text in rows]
    lines = lines_of(wanted, gates=len(gates), room=(bottom - top) // _LINE_PX)
    shown = [(*row, count) for row, count in zip(rows, lines, strict=True) if count]
    if left_out := len(rows) - len(shown):
        shown.insert(len(told) - left_out, ("-", SOFT_TEXT, f"and {left_out} more", 1))
    for mark, ink, text, count in shown:
        draw.text((left, top), mark, fill=ink, font=font(_SIZE_PX))
        for line in wrap(text, width - _INDENT_PX, _SIZE_PX, max_lines=count):
            draw.text((left + _INDENT_PX, top), line, fill=TEXT, font=font(_SIZE_PX))
            top += _LINE_PX


def lines_of(wanted: Sequence[int], *, gates: int, room: int) -> list[int]:
    """Distribute lines: first to the gates, then to the tracks, and the rest to the first reason.

    Args:
        wanted: Lines that each reason takes in full; the gates come last.
        gates: Number of gates among them; none is left out, whatever room there is.
        room: Lines in total; one is kept for the number of omitted tracks.

    Returns:
        Lines of each reason; 0 for omitted ones.
    """
    tracks = len(wanted) - gates
    lines = [min(each, _FEWEST) for each in wanted]
    if sum(lines[tracks:]) + sum(lines[: min(tracks, 1)]) + (tracks > 1) > room:
        lines = [1] * len(wanted)
    shown = tracks
    while shown and sum(lines[:shown]) + sum(lines[tracks:]) + (shown < tracks) > room:
        shown -= 1
        lines[shown] = 0
    spare = room - sum(lines) - (shown < tracks)
    for index, full in enumerate(wanted):
        if lines[index]:
            more = min(full - lines[index], max(0, spare))
            lines[index] += more
            spare -= more
    return lines


def _tells_a_track(reason: str, score: SceneScore) -> bool:
    """Return true if a reason is about a track; gates have none, and come last."""
    return score.state is SceneState.SCORED and not reason.startswith(_GATES)
