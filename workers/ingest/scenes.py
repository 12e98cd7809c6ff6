"""Scenes of a shard's labelled frames; every frame is in exactly one.

Scenes are the cells of the log's grid. A gap or a jump back in time ends a scene inside its cell; a
short piece joins the scene before it, unless a gap is between them. Where shards meet, both see the
piece and decide by the same numbers, so the scenes do not depend on how a log is cut into shards.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import CONTEXT_S, LabelledFrame, Scene
from schemas.work import Shard

MAX_GAP_S: Final = 0.5
"""Largest step between two frames of a scene: five missed revolutions of a 10 Hz lidar."""

MIN_SCENE_S: Final = 1.0
"""Shortest piece that is a scene of its own."""

_Side = tuple[LabelledFrame, ...]


@dataclass(frozen=True, slots=True)
class CutRule:
    """Lengths by which scenes are cut, for one length of cells.

    Cells shorter than two seconds shrink both limits, so that a piece with frames on both sides of
    it is never short. A scene is then joined by at most one piece, and a lookahead of
    `lookahead_ns` always decides it.
    """

    cell_ns: int

    @classmethod
    def of(cls, scene_s: float) -> "CutRule":
        """Build the rule for cells of this length."""
        return cls(round(scene_s * NS_PER_S))

    @property
    def max_gap_ns(self) -> int:
        """Largest step between two frames that is no gap."""
        return min(round(MAX_GAP_S * NS_PER_S), self.cell_ns // 4)

    @property
    def min_scene_ns(self) -> int:
        """Time between first and last frame below which a piece is short."""
        return min(round(MIN_SCENE_S * NS_PER_S), self.cell_ns // 2)

    @property
    def beside_ns(self) -> int:
        """Frames this near before and after a scene go with it, as far as its shard sees."""
        return min(round(CONTEXT_S * NS_PER_S), self.cell_ns // 2)

    @property
    def lookbehind_ns(self) -> int:
        """Time that a shard must see before its window to decide if its first piece continues."""
        return self.max_gap_ns

    @property
    def lookahead_ns(self) -> int:
        """Time that a shard must see after its window to decide if a short piece joins it.

        The piece begins within a gap's length, ends before the shortest scene, and a gap follows.
        """
        return 2 * self.max_gap_ns + self.min_scene_ns

    def breaks(self, before_ns: int, after_ns: int) -> bool:
        """Return True if a scene ends between two frames, by a gap or a jump back in time."""
        return not 0 <= after_ns - before_ns <= self.max_gap_ns


@dataclass(slots=True)
class _Piece:
    """Frames of one cell without a break.

    Attributes:
        cell: Number of the cell, 0 at the log's first frame.
        continues: There is no break between it and the frame before it.
        frames: At least one.
    """

    cell: int
    continues: bool
    frames: list[LabelledFrame] = field(default_factory=list)

    @property
    def start_ns(self) -> int:
        return self.frames[0].stamp_ns

    @property
    def end_ns(self) -> int:
        return self.frames[-1].stamp_ns


def cut_scenes(shard: Shard, labelled: Iterable[LabelledFrame]) -> Iterator[Scene]:
    """Cut the labelled frames of a shard into its scenes.

    Warm-up and lookahead frames are consumed; they only decide which pieces continue others, and
    are the frames right before and after a scene. At most two scenes are in memory.

    Args:
        shard: The window, and the windows of its neighbours.
        labelled: Frames in the order of the log, warm-up and lookahead included.

    Yields:
        Scenes that begin in the shard's window, in the order of the log.
    """
    rule = CutRule.of(shard.scene_s)
    times_used: dict[int, int] = {}
    for before, frames, after in _with_sides(
        rule, _joined(shard, rule, _pieces(rule, shard.anchor_ns, labelled))
    ):
        start_ns = frames[0].stamp_ns
        if not _begins_in_window(shard, start_ns):
            continue
        times_used[start_ns] = times_used.get(start_ns, 0) + 1
        repeat = f"-{times_used[start_ns]}" if times_used[start_ns] > 1 else ""
        yield Scene(
            scene_id=f"{shard.log_id}/{shard.lidar_name}/{start_ns}{repeat}",
            frames=tuple(frames),
            too_short=frames[-1].stamp_ns - start_ns < rule.min_scene_ns,
            before=before,
            after=after,
        )


def _with_sides(
    rule: CutRule, scenes: Iterable[tuple[list[LabelledFrame], _Piece | None]]
) -> Iterator[tuple[_Side, list[LabelledFrame], _Side]]:
    """Add to every scene the frames right before and after it, unless a gap is between."""
    before: _Side = ()
    for frames, piece in scenes:
        after: _Side = ()
        last: _Side = ()
        if piece is not None and piece.continues:
            end_ns, next_ns = frames[-1].stamp_ns, piece.start_ns
            after = tuple(e for e in piece.frames if e.stamp_ns - end_ns <= rule.beside_ns)
            last = tuple(e for e in frames if next_ns - e.stamp_ns <= rule.beside_ns)
        yield before, frames, after
        before = last


def _pieces(rule: CutRule, anchor_ns: int, labelled: Iterable[LabelledFrame]) -> Iterator[_Piece]:
    piece: _Piece | None = None
    for frame in labelled:
        cell = (frame.stamp_ns - anchor_ns) // rule.cell_ns
        continues = piece is not None and not rule.breaks(piece.end_ns, frame.stamp_ns)
        if piece is None or not continues or cell != piece.cell:
            if piece is not None:
                yield piece
            piece = _Piece(cell, continues)
        piece.frames.append(frame)
    if piece is not None:
        yield piece


def _joined(
    shard: Shard, rule: CutRule, pieces: Iterable[_Piece]
) -> Iterator[tuple[list[LabelledFrame], _Piece | None]]:
    """Join short pieces to the scene they continue; yield each scene with the next piece."""
    scene: list[LabelledFrame] = []
    for piece in pieces:
        short = piece.end_ns - piece.start_ns < rule.min_scene_ns
        if scene and piece.continues and short and _both_shards_see(shard, rule, piece):
            scene.extend(piece.frames)
            continue
        if scene:
            yield scene, piece
        scene = piece.frames
    if scene:
        yield scene, None


def _begins_in_window(shard: Shard, stamp_ns: int) -> bool:
    """Return True in the window; the first and last shard also own times outside the grid."""
    return (shard.first_of_log or stamp_ns >= shard.start_ns) and (
        shard.last_of_log or stamp_ns < shard.end_ns
    )


def _both_shards_see(shard: Shard, rule: CutRule, piece: _Piece) -> bool:
    """Return True if a short piece may join the one before it across a window's edge.

    It may if the shard before sees, within its lookahead, that the piece ends. The shard after
    makes the same test with the same numbers, and then leaves the piece to it.
    """
    if not shard.last_of_log and piece.start_ns >= shard.end_ns:
        return shard.lookahead_end_ns - piece.end_ns > rule.max_gap_ns
    at_start = shard.start_ns <= piece.start_ns < shard.start_ns + rule.cell_ns
    if not shard.first_of_log and at_start:
        return shard.before_lookahead_end_ns - piece.end_ns > rule.max_gap_ns
    return True
