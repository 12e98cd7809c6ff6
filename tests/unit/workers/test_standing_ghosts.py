"""Ghosts on structure: their box slides along what stands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from schemas.attribution import Wrong
from schemas.contradiction import LabelledFrame, Scene
from schemas.labels import FrameLabels, MotionLabel
from schemas.task import MOTION
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, ranked_tracks
from workers.contradiction.agreement import compare
from workers.contradiction.bled_labels import bled_likeness
from workers.contradiction.instances import find_instances
from workers.contradiction.standing_ghosts import path_share
from workers.contradiction.track_score import RankedTrack

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
WALL = Thing((12.0, 6.0, 0.0), STATIC, STATIC, (30.0, 0.1, 3.0), points=6000, class_id=0)
SPEED_M_PER_S = 3.0


def _frame(
    number: int, *, ghost: bool, witness: MotionLabel, others: Sequence[Thing] = ()
) -> LabelledFrame:
    """Return a wall, of which a stretch that slides is labelled dynamic."""
    frame = labelled_frame([WALL, *others], frame=number, time_s=number / 10)
    x_m = frame.posed.frame.points_m[:, 0] - 4.0 - SPEED_M_PER_S * number / 10
    labels = frame.semantic.labels.copy()
    labels[: WALL.points][ghost & (np.abs(x_m[: WALL.points]) < 1.5)] = DYNAMIC
    semantic = replace(frame.semantic, labels=labels)
    n = len(labels)
    seen = FrameLabels(np.full(n, witness, np.uint8), np.full(n, 0.8, np.float16))
    return replace(
        frame,
        semantic=semantic,
        agreements=compare(labels, frame.predictive.labels),
        witness=seen,
    )


def _track(witness: MotionLabel, *, others: Sequence[Thing] = ()) -> RankedTrack:
    made = [_frame(n, ghost=10 <= n < 22, witness=witness, others=others) for n in range(32)]
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


def test_labels_that_bleed_from_a_mover_onto_the_wall_behind_it_keep_their_path() -> None:
    passer = [
        Thing((2.0, 3.0, 0.0), DYNAMIC, DYNAMIC, (1.5, 0.5, 1.5), velocity_m_per_s=(1.5, 0, 0))
    ]
    alone, bled = _track(STATIC), _track(STATIC, others=passer)
    assert bled.features.displacement > 0.5 > alone.features.displacement
    assert bled.strength < 0.5 * alone.strength


def test_labels_that_bleed_onto_the_wall_behind_a_slow_mover_are_no_error_on_an_object() -> None:
    mover = Thing((4.0, 3.0, 0.0), DYNAMIC, DYNAMIC, (1.5, 0.5, 1.5), velocity_m_per_s=(0.2, 0, 0))
    (bled,), (alone,) = _wall_tracks([mover], patch=True), _wall_tracks([], patch=True)
    assert alone.features.isolation < 0.3
    assert (alone.features.denied_share, alone.features.agreed_share) == (1.0, 0.0)
    assert bled.features.agreed_share > 0.75
    assert bled.attribution is not None
    assert bled.attribution.wrong is Wrong.NEITHER
    assert bled.strength < 0.3 * alone.strength


@pytest.mark.parametrize(
    ("bled", "isolation", "likeness"),
    [(1.0, 0.2, 1.0), (1.0, 0.45, 0.5), (1.0, 0.8, 0.0), (0.7, 0.2, 0.5), (0.4, 0.2, 0.0)],
)
def test_a_bled_label_is_a_patch_in_the_direction_of_a_mover(
    bled: float, isolation: float, likeness: float
) -> None:
    assert bled_likeness(bled, isolation=isolation) == pytest.approx(likeness)


def test_a_parked_car_next_to_a_mover_is_no_bled_label() -> None:
    parked = Thing((8.0, 6.0, 0.0), DYNAMIC, STATIC, (4.5, 1.8, 1.5))
    mover = Thing((4.0, 3.0, 0.0), DYNAMIC, DYNAMIC, (1.5, 0.5, 1.5), velocity_m_per_s=(1.5, 0, 0))
    (beside,), (alone,) = _wall_tracks([parked, mover]), _wall_tracks([parked])
    assert beside.features.agreed_share < 0.1
    assert beside.strength > 0.8 * alone.strength


def _striped(frame: LabelledFrame) -> LabelledFrame:
    """Label thin stripes of the wall dynamic, between x = 7 and 9 m."""
    x_m = frame.posed.frame.points_m[: WALL.points, 0]
    labels = frame.semantic.labels.copy()
    labels[: WALL.points][(np.abs(x_m - 8.0) < 1.0) & (x_m % 0.4 < 0.08)] = DYNAMIC
    return replace(
        frame,
        semantic=replace(frame.semantic, labels=labels),
        agreements=compare(labels, frame.predictive.labels),
    )


def _wall_tracks(things: Sequence[Thing], *, patch: bool = False) -> Sequence[RankedTrack]:
    """Return the tracks of a scene with a wall and these things, which the witness sees stand.

    With `patch` stripes of the wall, 8 cm wide, are labelled dynamic.
    """
    made = [_frame(n, ghost=False, witness=STATIC, others=things) for n in range(32)]
    if patch:
        made = [_striped(frame) for frame in made]
    scene = Scene(
        scene_id=f"fleet/car-1/drive/lidar/{START_NS}",
        frames=tuple(made[10:22]),
        before=tuple(made[:10]),
        after=tuple(made[22:]),
    )
    return ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))


@pytest.mark.parametrize(
    ("kind", "witness_static", "share"),
    [
        ("only_semantic_dynamic", 1.0, 0.0),
        ("only_semantic_dynamic", 0.875, 0.5),
        ("only_semantic_dynamic", 0.5, 1.0),
        ("only_predictive_dynamic", 1.0, 1.0),
        ("only_witness_dynamic", 1.0, 1.0),
    ],
)
def test_nothing_arrives_where_free_space_found_every_place_occupied(
    kind: str, witness_static: float, share: float
) -> None:
    found = path_share(MOTION.kind(kind), MOTION, witness_static=witness_static)
    assert found == pytest.approx(share)
