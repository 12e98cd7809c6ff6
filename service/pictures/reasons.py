"""Drawing of a scene's reasons: those of the whole scene always, tracks as space allows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from PIL import ImageDraw

from schemas.arrays import NS_PER_S
from schemas.score import SceneScore
from schemas.task import task_named
from service.pictures.style import SOFT_TEXT, TEXT, Colour, font, inks_of, wrap

_LINE_PX: Final = 21
_SIZE_PX: Final = 16
_INDENT_PX: Final = 20
_FEWEST: Final = 2
"""Lines of a shown reason at most, unless there is room for all of its lines."""


@dataclass(frozen=True, slots=True)
class _Row:
    """A reason in a picture: its mark, the colour of the mark, its headline and its evidence."""

    mark: str
    ink: Colour
    headline: str
    evidence: str = ""

    def lines(self, width: int, *, count: int) -> list[tuple[str, Colour]]:
        """Break headline and evidence into so many lines at most, each with its colour."""
        head = wrap(self.headline, width, _SIZE_PX, max_lines=count)
        more = wrap(self.evidence, width, _SIZE_PX, max_lines=count - len(head))
        return [*((line, TEXT) for line in head), *((line, SOFT_TEXT) for line in more)]


def draw_reasons(
    draw: ImageDraw.ImageDraw, score: SceneScore, *, left: int, top: int, width: int, bottom: int
) -> None:
    """List the reasons, each with its headline first, and below it evidence and moment."""
    of_tracks, gates = _rows(score)
    rows, width = [*of_tracks, *gates], width - _INDENT_PX
    wanted = [len(row.lines(width, count=99)) for row in rows]
    lines = lines_of(wanted, gates=len(gates), room=(bottom - top) // _LINE_PX)
    shown = [(row, count) for row, count in zip(rows, lines, strict=True) if count]
    if left_out := len(rows) - len(shown):
        shown.insert(len(of_tracks) - left_out, (_Row("-", SOFT_TEXT, f"and {left_out} more"), 1))
    for row, count in shown:
        draw.text((left, top), row.mark, fill=row.ink, font=font(_SIZE_PX))
        for line, ink in row.lines(width, count=count):
            draw.text((left + _INDENT_PX, top), line, fill=ink, font=font(_SIZE_PX))
            top += _LINE_PX


def _rows(score: SceneScore) -> tuple[list[_Row], list[_Row]]:
    """Return the reasons about tracks, with number and colour, and those about the scene."""
    task = task_named(score.task)
    of_tracks, gates = [], []
    for reason in score.reasons:
        if reason.track_id is None or reason.track_id >= len(score.tracks):
            gates.append(_Row("-", SOFT_TEXT, reason.headline, reason.evidence))
            continue
        track = score.tracks[reason.track_id]
        at_s = (track.strongest.stamp_ns - score.start_ns) / NS_PER_S
        ink = inks_of(task)[task.kind(track.kind).code]
        parts = (reason.evidence, f"strongest at {at_s:.1f} s")
        evidence = "; ".join(part for part in parts if part)
        of_tracks.append(_Row(str(track.track_id + 1), ink, reason.headline, evidence))
    return of_tracks, gates


def lines_of(wanted: Sequence[int], *, gates: int, room: int) -> list[int]:
    """Allocate lines to reasons: first to gates, then to tracks, and the rest in order.

    Args:
        wanted: Number of lines of each reason in full; the gates come last.
        gates: Number of reasons about the whole scene; none of them is left out.
        room: Number of lines; one is reserved for the number of tracks that are left out.

    Returns:
        Lines of each reason; 0 for one that is left out.
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
