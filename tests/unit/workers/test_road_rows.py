"""Rows of road next to near movers."""

import numpy as np

from schemas.labels import MotionLabel
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, ranked_tracks
from workers.contradiction.instances import find_instances
from workers.contradiction.road_rows import road_rows

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
ROAD = Thing((10.0, 5.0, -1.8), STATIC, STATIC, (12.0, 8.0, 0.02), points=2000, ground=True)
WALKS = (1.5, 0.0, 0.0)
CYCLIST = Thing((8.0, 5.0, -0.9), DYNAMIC, DYNAMIC, (1.8, 0.5, 1.6), velocity_m_per_s=WALKS)
PATCH = Thing((8.0, 5.8, -1.78), STATIC, DYNAMIC, (1.5, 0.6, 0.04), velocity_m_per_s=WALKS)
SILL = Thing((8.0, 5.8, -1.4), STATIC, DYNAMIC, (1.5, 0.6, 0.3), velocity_m_per_s=WALKS)


def test_a_patch_of_road_beside_a_cyclist_is_no_object() -> None:
    scene = labelled_scene([ROAD, CYCLIST, PATCH], frames=10)
    assert find_instances(scene, class_names=CLASS_NAMES) == ()


def test_what_is_higher_than_the_road_is_an_object() -> None:
    scene = labelled_scene([ROAD, CYCLIST, SILL], frames=10)
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    assert len(track.track.members) == 10


def test_without_ground_around_nothing_is_road() -> None:
    points_m = np.array([[5.0, 0.0, -1.8], [60.0, 0.0, -1.8], [500.0, 0.0, -1.8]], np.float32)
    candidates = np.array([True, False, True])
    ground = np.array([False, True, False])
    assert not road_rows(points_m, candidates, ground).any()
    ground[0] = True
    assert road_rows(points_m, candidates, ground).tolist() == [True, False, False]
