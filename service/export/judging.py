"""Contradictions judged by finished labels: each track is a failure of a stream, or none."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import PermanentError
from schemas.overlay import Overlay
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from schemas.verdict import Verdict
from service.curation.verdicts import JudgeRequest, key_of_content
from service.export.label_import import LabelledFrame
from service.export.labels.finished import DYNAMIC, UNKNOWN
from service.export.points import moving_by_outcome

LEAST_JUDGED: Final = 0.5
"""Share of a track's points that the labels must judge, else the track is `unsure`."""

UNSURE: Final = "unsure"

MOST_WRONG: Final = 0.5
"""Share of judged points that a stream labels otherwise than the truth, from which it is wrong."""


NOTE: Final = "from imported labels"
"""Note of the verdicts that imported labels give."""


class OtherPointsError(PermanentError):
    """The labels are of other points than the overlay."""


@dataclass(frozen=True, slots=True)
class JudgedContradiction:
    """A track of a scene, judged by the labels of its points.

    Attributes:
        track_id: The track, as in the record and beyond.
        points: Its points in the labelled frames.
        judged_share: Share of them that the labels judge.
        supervised_wrong: Share of the judged points that the supervised stream labels wrong.
        selfsupervised_wrong: The same of the self-supervised stream.
        verdict: `supervised`, `self_supervised`, `both`, `neither`, or `unsure`.
    """

    track_id: int
    points: int
    judged_share: float
    supervised_wrong: float
    selfsupervised_wrong: float
    verdict: str


def judge(overlay: Overlay, frames: Sequence[LabelledFrame]) -> list[JudgedContradiction]:
    """Compare both streams with the labels on the points of every track.

    Args:
        overlay: Overlay of the scene.
        frames: Its labelled frames.

    Returns:
        A judgement of each track that has points in these frames, by track.

    Raises:
        OtherPointsError: If a frame has another number of points.
    """
    semantic, predictive = moving_by_outcome(overlay.task)
    counts: dict[int, NDArray[np.int64]] = {}
    for frame in frames:
        points = _points_of(overlay, frame)
        instance = overlay.instance_index[points]
        of_tracks = np.flatnonzero(instance >= 0)
        track = overlay.instance_track[instance[of_tracks]]
        motion = frame.motion[of_tracks]
        outcome = overlay.agreements[points][of_tracks]
        judged, moves = motion != UNKNOWN, motion == DYNAMIC
        facts = np.stack(
            [
                np.ones(len(of_tracks), dtype=np.int64),
                judged,
                judged & (semantic[outcome] != moves),
                judged & (predictive[outcome] != moves),
            ]
        ).astype(np.int64)
        for number in np.unique(track).tolist():
            mine = facts[:, track == number].sum(axis=1)
            counts[number] = counts.get(number, np.zeros(4, dtype=np.int64)) + mine
    return [_judged(number, counts[number]) for number in sorted(counts)]


def _points_of(overlay: Overlay, frame: LabelledFrame) -> slice:
    """Return the points of a labelled message in the overlay.

    Raises:
        OtherPointsError: If the overlay has another number of points of that lidar.
    """
    first = overlay.points_of(frame.number).start + frame.first
    counts = [overlay.main_points[frame.number], *(o.points[frame.number] for o in overlay.lidars)]
    firsts = np.cumsum([0, *counts[:-1]]).tolist()
    points = sum(int(n) for at, n in zip(firsts, counts, strict=True) if at == frame.first)
    if points != len(frame.words):
        raise OtherPointsError(
            f"frame {frame.number} has {len(frame.words)} points in the export and "
            f"{points} in the overlay: its log was replaced since"
        )
    return slice(first, first + points)


def _judged(track_id: int, counts: NDArray[np.int64]) -> JudgedContradiction:
    points, judged, supervised, selfsupervised = counts.tolist()
    shares = {
        "supervised": supervised / max(judged, 1),
        "self_supervised": selfsupervised / max(judged, 1),
    }
    wrong = [name for name, share in shares.items() if share > MOST_WRONG]
    verdict = "both" if len(wrong) == 2 else "".join(wrong) or "neither"
    return JudgedContradiction(
        track_id=track_id,
        points=points,
        judged_share=judged / points,
        supervised_wrong=shares["supervised"],
        selfsupervised_wrong=shares["self_supervised"],
        verdict=verdict if judged >= LEAST_JUDGED * points else UNSURE,
    )


def verdicts_of(
    judged: Sequence[JudgedContradiction], score: SceneScore, digest: str, reviewer: str
) -> list[JudgeRequest]:
    """Return the verdicts on those tracks that are strong in the record and that are decided.

    Args:
        judged: Judgements of the scene's tracks.
        score: Record of the scene.
        digest: Its SHA-256.
        reviewer: Name under which they are stored.

    Returns:
        Requests whose keys follow from their content, so that a repeated import stores nothing.
    """
    strong = {track.track_id for track in score.tracks if track.strength >= MIN_REPORTED_STRENGTH}
    return [
        JudgeRequest(
            key=key_of_content(reviewer, digest, str(each.track_id), each.verdict),
            scene_id=score.scene_id,
            sha256=digest,
            track_id=each.track_id,
            reviewer=reviewer,
            verdict=Verdict(each.verdict),
            note=NOTE,
        )
        for each in judged
        if each.track_id in strong and Verdict(each.verdict) is not Verdict.UNSURE
    ]


def counted_verdicts(judged: Sequence[JudgedContradiction]) -> Mapping[str, int]:
    """Count the verdicts by name, the commonest first."""
    counts: dict[str, int] = {}
    for each in judged:
        counts[each.verdict] = counts.get(each.verdict, 0) + 1
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))
