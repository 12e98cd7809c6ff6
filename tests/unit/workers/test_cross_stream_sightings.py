from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from schemas.contradiction import ContradictionKind, Scene
from schemas.labels import FrameLabels, MotionLabel
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, ranked_tracks
from workers.contradiction.instances import find_instances
from workers.contradiction.track_score import RankedTrack

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
STEP_M = 0.8
PIECES = [UNKNOWN] * 5 + [DYNAMIC] * 4


def _track(
    said: Sequence[int],
    *,
    witness: bool = True,
    aside_m: float = 0.0,
    seen_share: float = 1.0,
    others: tuple[Thing, ...] = (),
) -> RankedTrack:
    """The track of a car that the supervised stream calls static throughout.

    Args:
        said: What the self-supervised stream says of it, frame by frame.
        witness: Whether the witness sees it move, in every frame.
        aside_m: How far beside it lies what the witness sees where the other one is silent.
        seen_share: Share of its points that the witness sees move where the other one is silent.
        others: What else is there, of which the witness says the same.
    """
    frames = []
    for number, predictive in enumerate(said):
        y_m = 5.0 + (aside_m if predictive == UNKNOWN else 0.0)
        car = Thing((12.0 + STEP_M * number, y_m, 0.0), STATIC, predictive)
        frame = labelled_frame([car, *others], frame=number, time_s=number / 10.0)
        n = len(frame.posed.frame)
        labels = np.full(n, DYNAMIC, np.uint8)
        if predictive == UNKNOWN:
            labels[np.arange(n) >= seen_share * n] = UNKNOWN
        moves = FrameLabels(labels, (labels == DYNAMIC).astype(np.float16))
        frames.append(replace(frame, witness=moves if witness else None))
    scene = Scene(f"fleet/car-1/drive/lidar/{START_NS}", tuple(frames))
    mine = [
        each
        for each in ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
        if each.track.kind.name == ContradictionKind.ONLY_PREDICTIVE_DYNAMIC
        and abs(each.track.centres_m[0, 1] - 5.0) < 1.0
    ]
    return max(mine, key=lambda each: each.presence)


@pytest.mark.parametrize(
    "said",
    [PIECES, PIECES[::-1], [DYNAMIC] * 3 + [UNKNOWN] * 2 + [DYNAMIC] * 4],
    ids=["the witness sees it first", "the witness sees it last", "in turns"],
)
def test_what_the_witness_sees_in_its_stead_makes_a_track_last(said: list[int]) -> None:
    whole, pieces, alone = _track([DYNAMIC] * 9), _track(said), _track(said, witness=False)
    assert len(pieces.track.members) < len(whole.track.members)
    assert pieces.presence == pytest.approx(whole.presence, abs=0.01)
    assert alone.presence < 0.8 * pieces.presence


def test_a_sighting_elsewhere_is_another_object() -> None:
    assert _track(PIECES, aside_m=6.0).presence == _track(PIECES, witness=False).presence


def test_sightings_count_less_in_clutter() -> None:
    crowd = tuple(Thing((0.0, 20.0 + 8.0 * lane, 0.0), STATIC, DYNAMIC) for lane in range(8))
    alone = _track(PIECES, witness=False).presence
    assert alone < _track(PIECES, others=crowd).presence < 0.5 * (alone + _track(PIECES).presence)


def test_a_track_of_two_frames_is_not_extended() -> None:
    said = [UNKNOWN] * 5 + [DYNAMIC] * 2
    assert _track(said).presence == _track(said, witness=False).presence


def test_a_sighting_of_a_fragment_counts_by_its_points() -> None:
    whole, scrap = (_track(PIECES, seen_share=share).presence for share in (1.0, 0.7))
    assert _track(PIECES, witness=False).presence < scrap < 0.9 * whole
