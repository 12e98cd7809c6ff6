import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from workers.lidar.preprocessing import PreprocessedFrame
from workers.points.se3 import inverse
from workers.points.voxels import Voxels
from workers.selfsupervised.ground_reattachment import reattach_ground

MOVER_M = np.array([[10.0, 0.0, -1.0], [10.5, 0.0, -1.0]], np.float32)
CONFIRMED = np.array([False, True])
POSE = np.eye(4)
POSE[:3, 3] = (100.0, 50.0, 2.0)


def prepared(ground_m: NDArray[np.float32]) -> PreprocessedFrame:
    """Two voxels of a mover, and points that were taken for ground, far off the origin."""
    places = np.concatenate([MOVER_M, ground_m]).astype(np.float32)
    return PreprocessedFrame(
        points_m=places,
        valid_index=np.arange(len(places)),
        ground=np.arange(len(places)) >= len(MOVER_M),
        judged_index=np.arange(len(MOVER_M)),
        voxels=Voxels(
            (MOVER_M + POSE[:3, 3]).astype(np.float32), np.arange(len(MOVER_M), dtype=np.int32)
        ),
        image=np.zeros((2, 4), np.float32),
        odom_from_beams=POSE,
        beams_from_odom=inverse(POSE),
    )


def belongs(at: tuple[float, float, float], *, free: bool, moves: bool = True) -> tuple[bool, bool]:
    frame = prepared(np.array([at], np.float32))
    asked: list[Points] = []

    def seen_through(places_m: Points) -> Mask:
        asked.append(places_m)
        return np.full(len(places_m), free)

    moving = np.full(len(MOVER_M), moves)
    of_mover, of_confirmed = reattach_ground(frame, moving, CONFIRMED, frame.ground, seen_through)
    for places_m in asked:
        expected_m = np.broadcast_to(at, places_m.shape)
        np.testing.assert_allclose(places_m - POSE[:3, 3], expected_m, atol=1e-4)
    assert not of_mover[: len(MOVER_M)].any()
    return bool(of_mover[-1]), bool(of_confirmed[-1])


def test_ground_that_touches_a_mover_is_of_it_and_as_sure_as_it() -> None:
    assert belongs((9.9, 0.0, -1.1), free=False) == (True, False)
    assert belongs((10.6, 0.0, -1.1), free=False) == (True, True)


@pytest.mark.parametrize("free", [True, False])
def test_ground_beside_a_mover_is_of_it_where_the_street_behind_was_seen(*, free: bool) -> None:
    assert belongs((9.7, 0.0, -1.2), free=free) == (free, False)
    assert belongs((10.8, 0.0, -1.2), free=free) == (free, free)


def test_ground_farther_away_is_of_nobody_whatever_was_seen() -> None:
    assert belongs((9.4, 0.0, -1.0), free=True) == (False, False)


def test_ground_beside_what_stands_is_ground() -> None:
    assert belongs((9.9, 0.0, -1.1), free=True, moves=False) == (False, False)
