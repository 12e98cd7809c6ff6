"""Ghosts on structure: their box slides along what stands."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.attribution import Wrong
from schemas.contradiction import LabelledFrame, Scene
from schemas.labels import FrameLabels, MotionLabel
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, ranked_tracks
from workers.contradiction.agreement import compare
from workers.contradiction.instances import find_instances
from workers.contradiction.track_score import RankedTrack

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
WALL = Thing((12.0, 6.0, 0.0), STATIC, STATIC, (30.0, 0.1, 3.0), points=6000, class_id=0)
SPEED_M_PER_S = 3.0


def _frame(number: int, *, ghost: bool, witness: MotionLabel) -> LabelledFrame:
    """Return a wall, of which a stretch that slides is labelled dynamic."""
    frame = labelled_frame([WALL], frame=number, time_s=number / 10)
    x_m = frame.posed.frame.points_m[:, 0] - 4.0 - SPEED_M_PER_S * number / 10
    labels = np.where(ghost & (np.abs(x_m) < 1.5), DYNAMIC, STATIC).astype(np.uint8)
    semantic = replace(frame.semantic, labels=labels)
    n = len(labels)
    seen = FrameLabels(np.full(n, witness, np.uint8), np.full(n, 0.8, np.float16))
    return replace(
        frame,
        semantic=semantic,
        agreements=compare(labels, frame.predictive.labels),
        witness=seen,
    )


def _track(witness: MotionLabel) -> RankedTrack:
    made = [_frame(n, ghost=10 <= n < 22, witness=witness) for n in range(32)]
    scene = Scene(
        scene_id=f"fleet/car-1/drive/lidar/{START_NS}",
        frames=tuple(made[10:22]),
        before=tuple(made[:10]),
        after=tuple(made[22:]),
    )
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    return track


def test_a_ghost_that_slides_along_a_wall_is_an_error_of_the_supervised_stream() -> None:
    track = _track(STATIC)
    assert track.attribution is not None
    assert track.attribution.wrong is Wrong.SUPERVISED
    assert track.strength > 0.6
    assert (track.features.displacement, track.features.straightness) == pytest.approx((0, 0))


def test_the_path_counts_where_the_witness_does_not_see_it_stand() -> None:
    assert _track(UNKNOWN).features.displacement > 0.6
