"""A long slow body: free space is asked at its ends, its inside joins it, and so do near points."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.free_space import FREE, OCCUPIED, count_votes
from workers.lidar.beam_table import BeamTable
from workers.lidar.preprocessing import PreprocessedFrame
from workers.points.clusters import Clusters, from_labels
from workers.points.se3 import inverse
from workers.points.voxels import voxelize
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.moving_bodies import complete_bodies
from workers.selfsupervised.near_points import continue_movers
from workers.selfsupervised.registration import RegistrationResiduals, build_reference
from workers.selfsupervised.tracker import Tracked
from workers.selfsupervised.verification import verify_motions

Points = NDArray[np.float32]
STEP_M = 0.15
SPEED_M_PER_S = 3.0
AGE_S = 0.5
CENTRE_M = np.zeros(3)


def side(
    x: tuple[float, float], y: float, z: tuple[float, float], *, depth_m: float = 0.0
) -> Points:
    """A wall of points along x, one voxel apart, as deep as wanted."""
    grid = np.meshgrid(
        np.arange(*x, STEP_M), np.arange(y, y + depth_m + 0.01, STEP_M), np.arange(*z, STEP_M)
    )
    return np.stack(grid, axis=-1).reshape(-1, 3).astype(np.float32)


def evidence_of(far: NDArray[np.int8]) -> FreeSpaceEvidence:
    return FreeSpaceEvidence(
        votes=count_votes([far], len(far)),
        after=count_votes([], len(far)),
        near=far,
        far=far,
        image=np.zeros((2, 1800), np.float32),
        table=BeamTable(np.array([-0.1, 0.1], np.float32), np.zeros(3), 0.03),
        sensor_height_m=1.8,
        beams_from_odom=np.eye(4),
    )


def registered(extent_m: float) -> RegistrationResiduals:
    """A cluster that fits clearly better after a shift by what it drove."""
    shift = np.array([[-SPEED_M_PER_S * AGE_S, 0.0, 0.0]], np.float32)

    def one(value: float) -> NDArray[np.float32]:
        return np.array([value], np.float32)

    return RegistrationResiduals(
        tried=np.ones(1, np.bool_),
        extent_m=one(extent_m),
        still_energy_far=one(0.18),
        still_energy_near=one(0.10),
        energy_far=one(0.05),
        energy_near=one(0.03),
        shift_far_m=shift,
        shift_near_m=(shift / 5).astype(np.float32),
        energy_between=one(0.03),
    )


@pytest.mark.parametrize(
    ("length_m", "new_m", "moves"),
    [
        pytest.param(16.0, 1.5, True, id="a lorry whose front is new"),
        pytest.param(16.0, 0.3, False, id="a wall of which a little is new"),
        pytest.param(4.2, 0.75, False, id="a car must be a quarter new"),
        pytest.param(4.2, 1.5, True, id="a car that is"),
    ],
)
def test_of_a_long_body_free_space_must_confirm_what_is_new_at_its_end(
    length_m: float, new_m: float, moves: bool
) -> None:
    points_m = side((0.0, length_m), 4.0, (0.0, 1.5))
    far = np.where(points_m[:, 0] > length_m - new_m, FREE, OCCUPIED).astype(np.int8)
    motions = verify_motions(
        points_m,
        from_labels(np.zeros(len(points_m), np.int32)),
        registered(length_m),
        evidence_of(far),
        near_age_s=0.1,
        far_age_s=AGE_S,
    )
    assert motions.registered.tolist() == [moves]
    assert motions.unconfirmed.tolist() == [not moves]


LOAD = side((0.0, 15.0), 4.0, (1.1, 1.8))


def found_of(*blocks: Points) -> tuple[Points, ClusterMotions, Tracked]:
    """The first block moves, proved; nothing is known of the others."""
    labels = np.repeat(np.arange(len(blocks)), [len(each) for each in blocks]).astype(np.int32)
    first = np.arange(len(blocks)) == 0
    velocity = np.where(first[:, None], [[SPEED_M_PER_S, 0.0, 0.0]], 0.0).astype(np.float32)
    found = ClusterMotions(
        clusters=from_labels(labels),
        registered=first,
        seen_through=np.zeros(len(blocks), np.bool_),
        unconfirmed=np.zeros(len(blocks), np.bool_),
        still=~first,
        velocity_m_per_s=velocity,
        near_velocity_m_per_s=velocity,
        extent_m=np.array([np.ptp(each[:, 0]) for each in blocks], np.float32),
    )
    return np.concatenate(blocks), found, Tracked(first, first, velocity)


@pytest.mark.parametrize(
    ("piece", "earlier_m", "belongs"),
    [
        pytest.param(side((4.0, 11.0), 4.6, (0.5, 0.9)), 1.5, True, id="chassis"),
        pytest.param(side((4.0, 11.0), 4.6, (0.5, 0.9)), 0.0, True, id="chassis, alike everywhere"),
        pytest.param(side((7.0, 7.4), 4.3, (0.3, 0.9)), 0.0, False, id="post that stands"),
        pytest.param(side((-6.0, 21.0), 4.6, (0.5, 0.9)), 0.0, False, id="rail that goes on"),
        pytest.param(side((4.0, 11.0), 3.3, (0.5, 0.9)), 1.5, False, id="rail this side of it"),
    ],
)
def test_pieces_inside_a_mover_belong_to_it_if_its_motion_explains_them(
    piece: Points, earlier_m: float, belongs: bool
) -> None:
    points_m, found, tracked = found_of(LOAD, piece)
    back = np.array([SPEED_M_PER_S * AGE_S, 0.0, 0.0], np.float32)
    rail = side((2.0, 13.0), 4.6, (0.5, 0.9))
    alike = earlier_m == 0.0 and np.ptp(piece[:, 0]) > 5.0
    before = rail if alike else piece - np.array([earlier_m, 0.0, 0.0], np.float32)
    far = build_reference(np.concatenate([LOAD - back, before]), CENTRE_M, AGE_S)
    whole = complete_bodies(points_m, found, tracked, far, centre_m=CENTRE_M)
    assert whole.dynamic.tolist() == [True, belongs]
    assert whole.confirmed.tolist() == [True, belongs]
    speed = SPEED_M_PER_S if belongs else 0.0
    assert whole.velocity_m_per_s[1].tolist() == pytest.approx([speed, 0.0, 0.0])


def test_without_a_mover_nothing_is_inside_one() -> None:
    points_m, found, tracked = found_of(LOAD, side((4.0, 11.0), 4.6, (0.5, 0.9)))
    none = replace(tracked, dynamic=np.zeros(2, np.bool_), confirmed=np.zeros(2, np.bool_))
    far = build_reference(points_m, CENTRE_M, AGE_S)
    assert not complete_bodies(points_m, found, none, far, centre_m=CENTRE_M).dynamic.any()


def frame_of(points_m: Points, clusters: list[Points]) -> tuple[PreprocessedFrame, Clusters]:
    """A frame whose judged points are some blocks; their voxels are clusters in that order."""
    judged = np.concatenate(clusters)
    voxels = voxelize(judged)
    labels = np.zeros(len(voxels.centroids_m), np.int32)
    labels[voxels.of_point] = np.repeat(np.arange(len(clusters)), [len(c) for c in clusters])
    everything = np.concatenate([judged, points_m])
    pose = np.eye(4)
    return (
        PreprocessedFrame(
            points_m=everything,
            valid_index=np.arange(len(everything)),
            ground=np.zeros(len(everything), np.bool_),
            judged_index=np.arange(len(judged)),
            voxels=voxels,
            image=np.zeros((2, 1800), np.float32),
            odom_from_beams=pose,
            beams_from_odom=inverse(pose),
        ),
        from_labels(labels),
    )


def test_near_points_continue_the_mover_that_they_touch_and_no_other_thing() -> None:
    flank = side((-8.0, 8.0), 2.2, (-0.6, 0.4))
    wall = side((-8.0, 8.0), -2.3, (-0.6, 0.4))
    far_side = [each[np.hypot(each[:, 0], each[:, 1]) > 2.5] for each in (flank, wall)]
    near_side = [each[np.hypot(each[:, 0], each[:, 1]) < 2.5] for each in (flank, wall)]
    roof = side((-0.8, 0.8), 0.0, (-0.5, -0.4), depth_m=0.6)
    prepared, clusters = frame_of(np.concatenate([*near_side, roof]), far_side)
    rows, owner = continue_movers(prepared, clusters, np.array([True, False]))
    of_flank = np.arange(len(near_side[0])) + sum(len(each) for each in far_side)
    assert rows.tolist() == of_flank.tolist()
    assert not owner.any()
    rows, _ = continue_movers(prepared, clusters, np.array([False, False]))
    assert len(rows) == 0
