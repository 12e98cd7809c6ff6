from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from tests import factories
from workers.selfsupervised.stream import Registration

HEIGHT_M = 1.8
PERIOD_NS = 100_000_000
ELEVATIONS = np.radians(np.arange(-18.0, 4.0, 0.5))
AZIMUTHS = np.radians(np.arange(-180.0, 180.0, 0.4) + 0.05)


@dataclass(frozen=True)
class Box:
    """An upright box on the road, and how fast it goes."""

    centre: tuple[float, float]
    size: tuple[float, float, float]
    velocity: tuple[float, float] = (0.0, 0.0)


WALLS = (Box((0.0, 20.0), (120.0, 1.0, 6.0)), Box((0.0, -20.0), (120.0, 1.0, 6.0)))
PARKED = Box((9.0, 6.0), (4.5, 1.8, 1.5))
DRIVING = Box((14.0, -5.0), (4.5, 1.8, 1.5), velocity=(-5.0, 0.0))
POST = Box((-8.0, 7.0), (0.4, 0.4, 3.0))


def scan(
    boxes: Sequence[Box], *, time_s: float, sensor: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.int16], NDArray[np.int64]]:
    """Cast every beam: points about the sensor, their beams, and which box each hit (-1 road)."""
    elevation, azimuth = np.meshgrid(ELEVATIONS, AZIMUTHS, indexing="ij")
    direction = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    beam = np.repeat(np.arange(len(ELEVATIONS)), len(AZIMUTHS)).astype(np.int16)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(direction[:, 2] < 0, -HEIGHT_M / direction[:, 2], np.inf)
        hit = np.full(len(direction), -1)
        for number, box in enumerate(boxes):
            centre = np.array(box.centre) + np.array(box.velocity) * time_s - np.array(sensor)
            middle = np.array([*centre, box.size[2] / 2 - HEIGHT_M])
            half = np.array(box.size) / 2
            first, second = (middle - half) / direction, (middle + half) / direction
            enter = np.minimum(first, second).max(axis=1)
            leave = np.maximum(first, second).min(axis=1)
            nearer = (enter > 0) & (enter < leave) & (enter < distance)
            distance[nearer], hit[nearer] = enter[nearer], number
    back = distance < 90.0
    # two centimetres of range noise: a perfect plane is what no ground removal is made for
    distance += np.random.default_rng(int(time_s * 1000)).normal(0.0, 0.02, len(distance))
    points = (direction[back] * distance[back, None]).astype(np.float32)
    return points, beam[back], hit[back]


def drive(
    boxes: Sequence[Box],
    *,
    frames: int = 12,
    speed_m_per_s: float = 0.0,
    with_rings: bool = True,
    gap_before: int | None = None,
    lost_at: int | None = None,
) -> Iterator[tuple[PosedFrame, NDArray[np.int64]]]:
    stamp_ns = 1_700_000_000_000_000_000
    start_ns = stamp_ns
    for number in range(frames):
        if number == gap_before:
            stamp_ns += 9 * PERIOD_NS
        time_s = (stamp_ns - start_ns) * 1e-9
        x = speed_m_per_s * time_s
        points, beam, hit = scan(boxes, time_s=time_s, sensor=(x, 0.0))
        n = len(points)
        frame = LidarFrame(
            log_id="street",
            stamp_ns=stamp_ns,
            points_m=points,
            intensity=np.zeros(n, np.float32),
            offset_ns=np.zeros(n, np.int32),
            ring=beam if with_rings else np.full(n, -1, np.int16),
            valid_mask=np.ones(n, np.bool_),
        )
        pose = np.eye(4)
        pose[0, 3] = x
        state = OdometryState.LOST if number == lost_at else OdometryState.HEALTHY
        yield PosedFrame(frame, pose, state), hit
        stamp_ns += PERIOD_NS


def label(drive: Iterator[tuple[PosedFrame, NDArray[np.int64]]]) -> list[FrameLabels]:
    return list(Registration()(posed for posed, _ in drive))


def share(
    labels: FrameLabels, hit: NDArray[np.int64], box: int, wanted: MotionLabel, *, ground: bool
) -> float:
    assert labels.ground_mask is not None
    of_box = (hit == box) & (ground | ~labels.ground_mask)
    return float((labels.labels[of_box] == wanted).mean())


BOXES = (*WALLS, PARKED, DRIVING, POST)


@pytest.mark.parametrize("with_rings", [True, False])
@pytest.mark.parametrize("speed_m_per_s", [0.0, 6.0])
def test_a_driving_car_is_dynamic_and_what_stands_is_static(
    speed_m_per_s: float, with_rings: bool
) -> None:
    world = list(drive(BOXES, speed_m_per_s=speed_m_per_s, with_rings=with_rings))
    answers = label(iter(world))
    last, hit = answers[-1], world[-1][1]
    assert share(last, hit, 3, MotionLabel.DYNAMIC, ground=True) > 0.95
    for standing in (0, 1, 2, 4):
        assert share(last, hit, standing, MotionLabel.DYNAMIC, ground=True) == 0.0
        assert share(last, hit, standing, MotionLabel.STATIC, ground=True) > 0.8


def test_the_velocity_of_a_moving_cluster_is_its_speed_over_the_ground() -> None:
    world = list(drive(BOXES, speed_m_per_s=6.0))
    last, hit = label(iter(world))[-1], world[-1][1]
    assert last.cluster is not None
    assert last.cluster_velocity_m_per_s is not None
    of_car = last.cluster[(hit == 3) & (last.cluster >= 0)]
    velocity = last.cluster_velocity_m_per_s[np.bincount(of_car).argmax()]
    np.testing.assert_allclose(velocity, [-5.0, 0.0, 0.0], atol=0.3)


@pytest.mark.parametrize("lookahead_s", [0.0, 0.5])
def test_labels_do_not_hang_on_where_odom_space_begins(lookahead_s: float) -> None:
    """A shard's odom space begins elsewhere than the log's; voxels must not be cut elsewhere."""
    here = [posed for posed, _ in drive(BOXES, frames=16, speed_m_per_s=6.0)]
    elsewhere = factories.pose(3.21, -1.07, np.radians(33.0))
    there = [replace(each, odom_from_sensor=elsewhere @ each.odom_from_sensor) for each in here]
    stream = Registration(lookahead_s)
    for one, other in zip(stream(here), stream(there), strict=True):
        assert (one.labels == other.labels).all()
        velocities = one.cluster_velocity_m_per_s, other.cluster_velocity_m_per_s
        assert velocities[0] is not None
        assert velocities[1] is not None
        turned = velocities[0] @ elsewhere[:3, :3].T
        np.testing.assert_allclose(velocities[1], turned, atol=1e-3)
    assert (one.labels == MotionLabel.DYNAMIC).any()


def test_nothing_off_the_ground_is_known_in_the_first_frames() -> None:
    answers = label(drive(BOXES, frames=3))
    for answer in answers:
        assert (answer.labels == MotionLabel.UNKNOWN).all()
        assert (answer.confidence == 0).all()


@pytest.mark.parametrize("lookahead_s", [0.5, 1.0])
def test_who_looks_ahead_answers_every_frame_once_in_order(lookahead_s: float) -> None:
    """Also across a gap, a lost pose, and at the end, which nothing comes after."""
    frames = list(drive(BOXES, frames=16, speed_m_per_s=6.0, gap_before=7, lost_at=12))
    pulled = 0

    def given() -> Iterator[PosedFrame]:
        nonlocal pulled
        for posed, _ in frames:
            pulled += 1
            yield posed

    waited = []
    for index, labels in enumerate(Registration(lookahead_s)(given())):
        waited.append(pulled - 1 - index)
        assert len(labels.labels) == len(frames[index][0].frame)
    assert index == len(frames) - 1
    # the frame after a gap is there when those before it wait no longer
    assert max(waited) == min(7, round(10 * lookahead_s))
    assert Registration(lookahead_s).version != Registration().version


@pytest.mark.parametrize(
    ("lookahead_s", "wanted"), [(0.0, MotionLabel.STATIC), (0.5, MotionLabel.DYNAMIC)]
)
def test_what_is_gone_a_moment_later_moves_for_who_waits(
    lookahead_s: float, wanted: MotionLabel
) -> None:
    here, gone = (list(drive(boxes, frames=18)) for boxes in ((*WALLS, PARKED), WALLS))
    world = [*here[:12], *gone[12:]]
    last = list(Registration(lookahead_s)(posed for posed, _ in world))[11]
    assert share(last, here[11][1], 2, wanted, ground=False) > 0.95


def test_a_pose_thrown_for_good_does_not_make_the_frames_before_it_move() -> None:
    frames = [posed for posed, _ in drive((*WALLS, PARKED, POST), frames=14, speed_m_per_s=6.0)]
    for index in range(8, 14):
        pose = frames[index].odom_from_sensor.copy()
        pose[1, 3] += 1.0
        frames[index] = replace(frames[index], odom_from_sensor=pose)
    for labels in list(Registration(1.0)(frames))[:8]:
        assert (labels.labels == MotionLabel.DYNAMIC).mean() < 0.002


def test_beams_that_are_learned_later_change_no_frame_that_waits() -> None:
    frames = []
    for number, (posed, _) in enumerate(drive(BOXES, frames=14)):
        frame = posed.frame
        seen = frame.valid_mask if number >= 11 else frame.ring % 3 == 0
        frames.append(replace(posed, frame=replace(frame, valid_mask=seen)))
    alone = list(Registration(1.0)(frames[:11]))
    for one, other in zip(alone, Registration(1.0)(frames), strict=False):
        np.testing.assert_array_equal(one.labels, other.labels)
        np.testing.assert_array_equal(one.confidence, other.confidence)
    assert (alone[-1].labels == MotionLabel.DYNAMIC).any()


def test_history_begins_anew_after_a_gap() -> None:
    answers = label(drive(BOXES, frames=9, gap_before=7))
    assert (answers[6].labels == MotionLabel.DYNAMIC).any()
    assert (answers[7].labels == MotionLabel.UNKNOWN).all()
    assert (answers[8].labels == MotionLabel.UNKNOWN).all()


def test_a_lost_pose_makes_everything_unknown_instead_of_moving() -> None:
    answers = label(drive(BOXES, frames=9, lost_at=7))
    assert (answers[6].labels == MotionLabel.DYNAMIC).any()
    assert (answers[7].labels == MotionLabel.UNKNOWN).all()


def test_nothing_moves_where_the_beams_are_no_cones_about_any_point() -> None:
    scrambled = []
    for posed, _ in drive(BOXES, frames=8):
        frame = posed.frame
        ring = np.random.default_rng(4).permutation(frame.ring)
        scrambled.append(PosedFrame(replace(frame, ring=ring), posed.odom_from_sensor))
    for answer in Registration()(scrambled):
        assert (answer.labels == MotionLabel.UNKNOWN).all()


def test_the_same_frames_give_the_same_labels() -> None:
    first, second = label(drive(BOXES)), label(drive(BOXES))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.labels, other.labels)
        np.testing.assert_array_equal(one.confidence, other.confidence)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(np.zeros((0, 3), np.float32), id="no point"),
        pytest.param(np.ones((1, 3), np.float32) * 5, id="one point"),
        pytest.param(np.ones((5000, 3), np.float32) * 5, id="all points equal"),
    ],
)
def test_a_frame_that_says_nothing_is_answered_and_does_not_end_the_stream(
    points: NDArray[np.float32],
) -> None:
    world = [each for each, _ in drive(BOXES, frames=9)]
    stamp_ns = world[6].frame.stamp_ns
    frames = [
        factories.posed(factories.frame(points, stamp_ns=world[0].frame.stamp_ns - PERIOD_NS)),
        *world[:6],
    ]
    frames += [factories.posed(factories.frame(points, stamp_ns=stamp_ns)), *world[7:]]
    answers = list(Registration()(frames))
    assert [len(answer.labels) for answer in answers] == [len(each.frame) for each in frames]
    assert (answers[-1].labels == MotionLabel.DYNAMIC).any()
