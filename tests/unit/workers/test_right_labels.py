"""Right labels of a drive, where truth does not judge."""

import numpy as np

from workers.lab.evaluation.failures.planting.right_labels import right_motion, whole_objects
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    TRUTH_UNKNOWN,
    FrameTruth,
)
from workers.lab.simulation.models.kinds import StreetClass

CAR, BUILDING = int(StreetClass.CAR), int(StreetClass.BUILDING)


def test_the_part_of_a_car_that_its_box_misses_moves_with_it() -> None:
    """A car along x in a box that lags: points behind 4 m are outside, and the last is no car."""
    points_m = np.array([[x, 0.0, 0.0] for x in (2.0, 3.0, 4.0, 4.8, 5.4, 5.2, 9.0)], np.float32)
    points_m[5, 1] = 0.3
    class_id = np.array([CAR] * 5 + [BUILDING, CAR], np.uint8)
    true = FrameTruth(
        number=0,
        motion=np.array([TRUTH_DYNAMIC] * 3 + [TRUTH_UNKNOWN] * 4, np.uint8),
        track=np.array([7, 7, 7, -1, -1, -1, -1], np.int16),
    )
    ground = np.zeros(7, np.bool_)
    assert true.track is not None
    track = whole_objects(true, true.track, points_m=points_m, class_id=class_id, ground=ground)
    assert track.tolist() == [7, 7, 7, 7, 7, -1, -1]
    motion = right_motion(true, track, ground)
    assert motion.tolist() == [TRUTH_DYNAMIC] * 5 + [TRUTH_STATIC] * 2


def test_a_loose_point_next_to_a_parked_car_belongs_to_it() -> None:
    points_m = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [1.0, 0.0, 0.0]], np.float32)
    true = FrameTruth(
        number=0,
        motion=np.array([TRUTH_STATIC, TRUTH_UNKNOWN, TRUTH_DYNAMIC], np.uint8),
        track=np.array([1, -1, 2], np.int16),
    )
    ground = np.zeros(3, np.bool_)
    assert true.track is not None
    class_id = np.full(3, CAR, np.uint8)
    track = whole_objects(true, true.track, points_m=points_m, class_id=class_id, ground=ground)
    assert track.tolist() == [1, 1, 2]
    assert right_motion(true, track, ground).tolist() == [1, 1, 2]
