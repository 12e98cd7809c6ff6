"""Labels of points by boxes: in, next to, below and outside; motion by velocity or path."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.boxes import RecordedBoxes
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.work import Channel, FurtherLidar
from tests.factories import BEGIN_NS, frame, pose, posed
from workers.ingest.joining import joined_frame
from workers.lidar.several_lidars import placed
from workers.parts.lidar_by_lidar import labels_of_lidars
from workers.points.points_in_boxes import points_in_boxes
from workers.supervised.box_labels import NO_MOTION
from workers.supervised.recorded import Recorded

S, D, U = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
NAN = float("nan")

PLACES = (
    (10.0, 0.0, 0.5),  # in the middle of the box
    (10.0, 0.0, -0.75),  # on the ground, within its lower face
    (12.2, 0.0, 0.5),  # 0.2 m before it
    (12.6, 0.0, 0.5),  # 0.6 m before it
    (-30.0, 0.0, 0.5),  # far from it
)


def boxes(
    centre: Any = ((10.0, 0.0, 0.0),),
    *,
    velocity: Any = ((NAN, NAN, NAN),),
    ids: tuple[str, ...] = ("",),
    movable: bool | None = True,
    moving: bool = False,
    score: float = 0.75,
    at_s: float = 0.0,
    yaw: float = 0.0,
) -> RecordedBoxes:
    centres = np.array(centre, np.float64)
    n = len(centres)
    turn = pose(0, 0, yaw)[:3, :3]
    return RecordedBoxes(
        stamp_ns=BEGIN_NS + round(at_s * NS_PER_S),
        centre_m=centres,
        size_m=np.tile([4.0, 2.0, 1.8], (n, 1)),
        sensor_from_box=np.tile(turn, (n, 1, 1)),
        velocity_m_per_s=np.array(velocity, np.float64).reshape(n, 3),
        score=np.full(n, score),
        class_name=("car",) * n,
        track_id=ids * n if len(ids) == 1 else ids,
        movable=(movable,) * n,
        moving=(moving,) * n,
    )


def label(*answers: RecordedBoxes | None, step_s: float = 0.1, ego: float = 0.0) -> FrameLabels:
    """Label the last frame of a few."""
    frames: list[PosedFrame] = [
        posed(frame(PLACES, at_s=number * step_s, boxes=answer), pose(ego * number * step_s))
        for number, answer in enumerate(answers)
    ]
    stream = Recorded()
    *_, last = stream(frames)
    assert stream.class_names in ((), ("car",))
    return last


def test_a_mover_is_in_its_box_and_neither_next_to_it_nor_on_the_ground_below() -> None:
    found = label(boxes(velocity=((5.0, 0.0, 0.0),)))
    assert found.labels.tolist() == [D, U, U, S, S]
    assert found.confidence.tolist() == [0.75, 0, 0, 1, 1]
    assert found.class_id is not None
    assert found.class_id.tolist() == [0, -1, -1, -1, -1]
    assert found.health.reason == ""


@pytest.mark.parametrize("creeps_m_per_s", [0.0, 0.1, 0.3, 0.49])
def test_a_parked_box_leaves_nothing_open(creeps_m_per_s: float) -> None:
    """A tracker reports up to half a metre a second for what stands."""
    found = label(boxes(velocity=((creeps_m_per_s, 0.0, 0.0),)))
    assert found.labels.tolist() == [S, S, S, S, S]


def test_between_standing_and_walking_motion_is_unknown() -> None:
    assert label(boxes(velocity=((0.6, 0.0, 0.0),))).labels[0] == U


def test_without_velocity_and_ids_the_model_says_no_motion() -> None:
    found = label(boxes())
    assert found.labels.tolist() == [U, U, U, S, S]
    assert found.health.reason == NO_MOTION


def test_classes_that_cannot_move_say_nothing_of_the_motion_of_others() -> None:
    centres, nan = ((10.0, 0.0, 0.0), (-30.0, 0.0, 0.0)), ((NAN, NAN, NAN),) * 2
    mixed = replace(boxes(centres, velocity=nan), movable=(True, False))
    assert label(mixed).health.reason == NO_MOTION
    assert label(boxes(movable=False)).health.reason == ""


def test_a_class_that_cannot_move_stands_without_a_velocity() -> None:
    assert label(boxes(movable=False)).labels[0] == S
    assert label(boxes(moving=True)).labels[0] == D


@pytest.mark.parametrize(("speed", "expected"), [(0.0, S), (6.0, D)])
def test_the_path_of_a_track_is_its_motion_whatever_the_car_does(
    speed: float, expected: MotionLabel
) -> None:
    ego = 8.0
    answers = [
        boxes(
            ((10.0 + (speed - ego) * 0.1 * (number - 9), 0.0, 0.0),),
            ids=("a",),
            at_s=0.1 * number,
        )
        for number in range(10)
    ]
    assert label(*answers, ego=ego).labels[0] == expected


def test_the_birth_of_a_track_tells_no_motion() -> None:
    born = [boxes(ids=("a",), at_s=0.1 * number) for number in range(2)]
    found = label(*born)
    assert found.labels[0] == U
    assert found.health.reason == ""


def test_boxes_of_another_time_are_moved_by_their_velocity() -> None:
    """40 ms before the cloud, whose middle is 50 ms after its stamp: 0.9 m at 10 m/s."""
    found = label(boxes(((9.1, 0.0, 0.0),), velocity=((10.0, 0.0, 0.0),), at_s=-0.04, ids=("a",)))
    assert found.labels.tolist() == [D, U, U, S, S]


def test_boxes_of_another_time_are_moved_with_the_car() -> None:
    before = boxes(((10.0, 0.0, 0.0),), velocity=((5.0, 0.0, 0.0),))
    ego = 10.0
    # 0.09 s before the middle of the sweep the sensor was 0.9 m behind, and the box 0.45 m
    placed = boxes(((10.45, 0.0, 0.0),), velocity=((5.0, 0.0, 0.0),), at_s=0.06)
    assert label(before, placed, ego=ego).labels.tolist() == [D, U, U, S, S]


def test_a_frame_without_an_answer_is_unknown_and_an_empty_answer_is_not() -> None:
    silent, empty = label(None), label(boxes(np.zeros((0, 3)), velocity=np.zeros((0, 3))))
    assert silent.labels.tolist() == [U] * 5
    assert not silent.health.answered
    assert empty.labels.tolist() == [S] * 5
    assert empty.health.answered
    assert empty.health.reason == ""


def plain(
    points: NDArray[np.float32], centre: Any, turn: Any, half: Any, margin: float, bottom: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Compare every point with every box, in float64."""
    local = np.einsum("nbi,bij->nbj", points[:, None, :] - centre[None], turn)
    depth = (np.abs(local) / half).max(axis=2)
    inside = (depth <= 1.0) & (local[:, :, 2] >= bottom - half[:, 2])
    near = (np.abs(local) <= half + margin).all(axis=2) & ~inside
    first = np.where(inside, depth, np.inf).argmin(axis=1)
    second = np.where(near, depth, np.inf).argmin(axis=1)
    return np.where(inside.any(axis=1), first, -1), np.where(near.any(axis=1), second, -1)


def test_the_kernel_equals_plain_numpy() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-40, 40, (4_000, 3)).astype(np.float32)
    points[:, 2] /= 20
    centre = rng.uniform(-40, 40, (60, 3)) * (1, 1, 0.02)
    half = rng.uniform(0.3, 6.0, (60, 3))
    turn = np.stack([pose(0, 0, yaw)[:3, :3] for yaw in rng.uniform(-3, 3, 60)])
    expected = plain(points, centre, turn, half, 0.3, 0.2)
    time_s = np.zeros(len(points), np.float32)
    found = points_in_boxes(points, time_s, centre, turn, half, np.zeros((60, 3)), 0.3, 0.2)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])
    assert (found[0] >= 0).sum() > 500


def test_points_and_boxes_beyond_any_range_are_passed_over() -> None:
    points = np.array([[1e30, 0, 0], [np.nan, 0, 0], [300, 0, 0], [0, 0, 0]], np.float32)
    far = np.array([[300.0, 0, 0], [0, 0, 0], [1e7, 1e7, 0]])
    inside, _ = points_in_boxes(
        points,
        np.zeros(4, np.float32),
        far,
        np.tile(np.eye(3), (3, 1, 1)),
        np.full((3, 3), 2.0),
        np.zeros((3, 3)),
        0.3,
        0.0,
    )
    assert inside.tolist() == [-1, -1, -1, 1]


def test_boxes_label_the_points_of_every_joined_lidar() -> None:
    mounted = pose(2.0, 0.0, np.pi / 2)
    of_front = frame([(0.0, -8.0, 0.5), (0.0, -20.0, 0.5)])  # at x = 10 and 22 m of the main lidar
    lidar = FurtherLidar(
        channel=Channel(
            topic="/front",
            message_encoding="cdr",
            schema_name="sensor_msgs/msg/PointCloud2",
            schema_encoding="ros2msg",
            schema_base64="",
            ids=((0, 1),),
        ),
        main_from_lidar=tuple(mounted.ravel().tolist()),
        period_ns=NS_PER_S // 10,
    )
    main = frame(PLACES, boxes=boxes(velocity=((5.0, 0.0, 0.0),)))
    joined = placed(joined_frame(main, [(lidar, of_front)]), None)
    stream = Recorded()
    (found,) = labels_of_lidars(stream, [posed(joined)])
    assert found.labels.tolist() == [D, U, U, S, S, D, S]
