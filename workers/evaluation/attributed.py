"""Who was really wrong about each track: what attribution is fitted on, and judged by."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Wrong
from schemas.contradiction import LabelledFrame
from schemas.labels import MotionLabel
from workers.contradiction.strength import RankedTrack, rank_tracks
from workers.evaluation.truth import TRUTH_DYNAMIC, TRUTH_STATIC, TRUTH_UNKNOWN, FrameTruth
from workers.pipeline import MinedScene

TruthOf = Callable[[LabelledFrame], FrameTruth | None]
"""The truth of a frame; None where it is not known."""

MIN_KNOWN_SHARE: Final = 0.5
MOST: Final = 0.5


class TrackRow(BaseModel):
    """One contradicting track with what is known about it and what it really was."""

    model_config = ConfigDict(frozen=True)

    scene_id: str
    track_id: int = Field(description="As in the scene's record.")
    kind: str
    evidence: dict[str, float]
    strength: float = Field(description="Before the odometry gate.")
    points: int
    frames: int
    moves_share: float = Field(description="Share of its points that really move.")
    wrong: Wrong = Field(description="Who was wrong about most of its points.")
    said: Wrong = Field(description="Who was said to be.")
    supervised: float = Field(description="Chance given to an error of the supervised stream.")


def rows_of(mined: MinedScene, truth_of: TruthOf) -> list[TrackRow]:
    """Judge the tracks of a scene; those of which truth knows less than half are left out."""
    rows = []
    for track_id, ranked in enumerate(rank_tracks(mined.scene, mined.instances)):
        row = _row(mined, ranked, track_id, truth_of)
        if row is not None:
            rows.append(row)
    return rows


def _row(
    mined: MinedScene, ranked: RankedTrack, track_id: int, truth_of: TruthOf
) -> TrackRow | None:
    if ranked.evidence is None or ranked.attribution is None:
        return None
    semantic, predictive, true = _gathered(mined, ranked.track.members, truth_of)
    known = true != TRUTH_UNKNOWN
    if not len(true) or float(known.mean()) < MIN_KNOWN_SHARE:
        return None
    moves_share = float((true[known] == TRUTH_DYNAMIC).mean())
    return TrackRow(
        scene_id=mined.scene.scene_id,
        track_id=track_id,
        kind=ranked.track.kind.name,
        evidence=dict(ranked.evidence.named()),
        strength=ranked.strength,
        points=ranked.points,
        frames=len(ranked.track.members),
        moves_share=moves_share,
        wrong=wrong_about(semantic[known], predictive[known], true[known]),
        said=ranked.attribution.wrong,
        supervised=ranked.attribution.supervised_wrong,
    )


def wrong_about(
    semantic: NDArray[np.uint8], predictive: NDArray[np.uint8], true: NDArray[np.uint8]
) -> Wrong:
    """Say who is wrong about most of some points; a stream that says nothing is not wrong.

    Args:
        semantic: (N,) labels of the supervised stream, N >= 1.
        predictive: (N,) labels of the self-supervised stream.
        true: (N,) true motion, in codes of the truth, all known.
    """
    supervised = _wrong_share(semantic, true) > MOST
    selfsupervised = _wrong_share(predictive, true) > MOST
    if supervised and selfsupervised:
        return Wrong.BOTH
    if supervised:
        return Wrong.SUPERVISED
    return Wrong.SELFSUPERVISED if selfsupervised else Wrong.NEITHER


def _wrong_share(said: NDArray[np.uint8], true: NDArray[np.uint8]) -> float:
    missed = (said == MotionLabel.STATIC) & (true == TRUTH_DYNAMIC)
    phantom = (said == MotionLabel.DYNAMIC) & (true == TRUTH_STATIC)
    return float((missed | phantom).mean())


def _gathered(
    mined: MinedScene, members: Sequence[int], truth_of: TruthOf
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
    """Labels of both streams and the truth, over the thing that a track lies on.

    The thing is the true object of most of its points, in the frames of the track; where they
    belong to none, the points themselves.
    """
    frames = [mined.scene.frames[mined.instances[member].frame_index] for member in members]
    truths = [truth_of(frame) for frame in frames]
    index = [mined.instances[member].point_index for member in members]
    thing = _thing(truths, index)
    said: list[NDArray[np.uint8]] = [np.zeros((3, 0), np.uint8)]
    for frame, true, mine in zip(frames, truths, index, strict=True):
        motion = np.full(len(frame.agreements), TRUTH_UNKNOWN, np.uint8)
        if true is not None:
            motion = true.motion
            if thing >= 0 and true.track is not None:
                mine = np.flatnonzero(true.track == thing)
        said.append(
            np.stack([frame.semantic.labels[mine], frame.predictive.labels[mine], motion[mine]])
        )
    semantic, predictive, true_motion = np.concatenate(said, axis=1)
    return semantic, predictive, true_motion


def _thing(truths: Sequence[FrameTruth | None], index: Sequence[NDArray[np.int64]]) -> int:
    """True object that half of the points belong to; -1 none."""
    tracks = [
        true.track[mine]
        for true, mine in zip(truths, index, strict=True)
        if true is not None and true.track is not None
    ]
    if not tracks:
        return -1
    ids, counts = np.unique(np.concatenate(tracks), return_counts=True)
    best = int(np.argmax(counts))
    return int(ids[best]) if 2 * int(counts[best]) >= sum(map(len, index)) else -1
