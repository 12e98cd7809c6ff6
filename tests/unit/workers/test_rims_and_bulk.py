"""Rims of agreed movers, and large movers that are labelled in part."""

import pytest

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind
from schemas.labels import MotionLabel
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, ranked_tracks
from workers.contradiction.bulk_motion import bulk_motion_of
from workers.contradiction.instances import find_instances
from workers.contradiction.track_score import RankedTrack

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
SPEED = (3.0, 0.0, 0.0)


def _part(x_m: float, length_m: float, points: int, semantic: MotionLabel, **more: float) -> Thing:
    """Return a part of a lorry that moves along x, of the height and width of all of it."""
    return Thing(
        (10.0 + x_m, 5.0, 0.0),
        semantic,
        DYNAMIC,
        (length_m, 2.5, 3.0),
        points=points,
        velocity_m_per_s=SPEED,
        confirmed_share=1.0,
    )


def _missed(*things: Thing) -> RankedTrack:
    scene = labelled_scene(things, frames=20)
    tracks = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    (track,) = [
        each
        for each in tracks
        if each.track.kind.name == ContradictionKind.ONLY_PREDICTIVE_DYNAMIC
        and len(each.track.members) > 3
    ]
    return track


def test_half_of_a_lorry_is_no_rim_of_the_other_half() -> None:
    track = _missed(_part(2.5, 5.0, 2400, DYNAMIC), _part(-2.5, 5.0, 2400, STATIC))
    assert track.features.agreed_share == pytest.approx(0.0)
    assert track.features.denied_share == pytest.approx(1.0)
    assert track.attribution is not None
    assert track.attribution.wrong is Wrong.SUPERVISED
    assert track.strength > 0.7
    assert "motion in bulk" in track.attribution.supporting


def test_a_lorry_labelled_in_patches_is_no_rim_by_its_points() -> None:
    patches = [_part(0.6 * k - 4.5, 0.6, 500, STATIC if k % 2 else DYNAMIC) for k in range(16)]
    track = _missed(*patches)
    assert track.features.agreed_share == pytest.approx(0.0)
    assert track.strength > 0.7


def test_a_thin_layer_next_to_an_agreed_mover_is_its_rim() -> None:
    track = _missed(_part(0.0, 5.0, 2400, DYNAMIC), _part(-2.7, 0.3, 120, STATIC))
    assert track.features.agreed_share > 0.5
    assert track.strength < 0.5


@pytest.mark.parametrize(
    ("points", "confirmed", "speed", "doubted", "bulk"),
    [
        (2_000, 1.0, 3.0, 0.0, 1.0),
        (500, 1.0, 3.0, 0.0, 0.0),
        (4_800, 0.0, 3.0, 0.0, 0.0),
        (4_800, 1.0, 0.0, 0.0, 0.0),
        (4_800, 1.0, 3.0, 1.0, 0.0),
    ],
    ids=["thousands", "few", "unconfirmed", "unmeasured", "a slip"],
)
def test_bulk_needs_points_confirmation_speed_and_healthy_poses(
    points: float, confirmed: float, speed: float, doubted: float, bulk: float
) -> None:
    assert bulk_motion_of(
        points=points, confirmed=confirmed, speed_m_per_s=speed, pose_doubted=doubted
    ) == pytest.approx(bulk)
