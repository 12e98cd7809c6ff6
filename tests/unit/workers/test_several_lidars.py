"""Points of several lidars fit each other while the car drives, and rays start where they did."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import JoinedLidar, LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import MOTION
from tests.factories import frame, pose, posed
from workers.free_space import FREE, HIDDEN, OCCUPIED, visibility, with_views
from workers.lidar.beam_image import range_image
from workers.lidar.compensation import to_middle
from workers.lidar.lidar_views import LidarViews
from workers.lidar.several_lidars import lidar_frame, placed, posed_frames, seen_from
from workers.parts.lidar_by_lidar import labels_of_lidars

SPEED = np.array([0.0, 0.0, 0.2, 15.0, 0.0, 0.0])
"""Twist of a car that turns at 15 m/s."""

FRONT = np.eye(4)
FRONT[:2, :2], FRONT[:3, 3] = [[0.0, -1.0], [1.0, 0.0]], (2.0, 0.5, -1.0)


def world(count: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    angle, away = rng.uniform(-np.pi, np.pi, count), rng.uniform(5, 40, count)
    return np.column_stack([away * np.cos(angle), away * np.sin(angle), rng.uniform(-1, 2, count)])


def exactly(twist: NDArray[np.float64], time_s: float) -> NDArray[np.float64]:
    """Return the pose of the car at a time, integrated in small steps."""
    place = np.eye(4)
    steps = 200
    for _ in range(steps):
        small = pose(twist[3] * time_s / steps, 0.0, twist[2] * time_s / steps)
        place = place @ small
    return place


def measured(
    points_m: NDArray[np.float64], times_s: NDArray[np.float64], mount: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points as a lidar on the moving car measures each at its own time."""
    own = np.empty_like(points_m)
    for i, time_s in enumerate(times_s):
        turned = np.linalg.inv(exactly(SPEED, time_s) @ mount)
        own[i] = turned[:3, :3] @ points_m[i] + turned[:3, 3]
    return own


def joined(main_times: bool = True) -> tuple[LidarFrame, NDArray[np.float64], NDArray[np.float64]]:
    """Return a joined frame, and where its points are in the main lidar's space at 50 ms."""
    seen, further = world(360, 1), world(200, 2)
    # a turn from behind, clockwise
    main_s = (np.pi - np.arctan2(seen[:, 1], seen[:, 0])) / (2 * np.pi) * 0.1
    late_s = 0.03 + np.linspace(0.0, 0.09, len(further))
    own = measured(further, late_s, FRONT)
    points = np.concatenate(
        [measured(seen, main_s, np.eye(4)), own @ FRONT[:3, :3].T + FRONT[:3, 3]]
    )
    offset = np.rint(np.concatenate([main_s, late_s]) * 1e9).astype(np.int32)
    made = frame(points, offset_ns=offset, has_point_time=True, compensated="auto")
    lidar = JoinedLidar("/front", len(own), made.stamp_ns + 30_000_000, FRONT, True)
    first, last = int(offset[:360].min()), int(offset[:360].max())
    middle = np.linalg.inv(exactly(SPEED, (first + last) / 2e9))
    true = np.concatenate([seen, further]) @ middle[:3, :3].T + middle[:3, 3]
    return replace(made, joined=(lidar,)), true, np.linalg.inv(middle)


def test_compensation_brings_the_points_of_both_lidars_to_where_they_are() -> None:
    made, true, _ = joined()
    moved = placed(made, SPEED)
    whole = to_middle(moved, moved.points_m, np.arange(len(made)), SPEED, np.zeros(3))
    np.testing.assert_allclose(whole, true, atol=0.02)
    # as mounted, without the car's motion, they are a metre off
    assert np.abs(made.points_m[360:] - true[360:]).max() > 0.8


def test_the_main_lidar_stays_as_recorded() -> None:
    made, _, _ = joined()
    moved = placed(made, SPEED)
    np.testing.assert_array_equal(moved.points_m[:360], made.points_m[:360])
    np.testing.assert_array_equal(moved.offset_ns[:360], made.offset_ns[:360])


def test_a_further_lidar_is_placed_in_the_middle_of_its_own_sweep() -> None:
    made, _, middle = joined()
    moved = placed(made, SPEED)
    there = np.linalg.inv(middle) @ exactly(SPEED, 0.075) @ FRONT
    np.testing.assert_allclose(moved.joined[0].main_from_lidar, there, atol=0.01)


def test_an_unknown_motion_places_lidars_as_mounted() -> None:
    made, _, _ = joined()
    moved = placed(made, None)
    np.testing.assert_array_equal(moved.points_m, made.points_m)
    np.testing.assert_array_equal(moved.joined[0].main_from_lidar, FRONT)


def test_the_twist_of_a_rigid_lidar() -> None:
    of_lidar = seen_from(SPEED, FRONT)
    step_s = 1e-4
    moved = np.linalg.inv(FRONT) @ exactly(SPEED, step_s) @ FRONT
    np.testing.assert_allclose(of_lidar[3:], moved[:3, 3] / step_s, atol=1e-2)
    np.testing.assert_allclose(of_lidar[:3], SPEED[:3])


def test_points_return_to_the_space_of_their_lidar() -> None:
    made, _, _ = joined()
    own = lidar_frame(made, 0)
    back = own.points_m @ FRONT[:3, :3].T + FRONT[:3, 3]
    np.testing.assert_allclose(back, made.points_m[360:], atol=1e-4)
    assert own.joined == ()


def test_odometry_sees_the_main_lidar_alone() -> None:
    made, _, _ = joined()
    later = [replace(made, stamp_ns=made.stamp_ns + n * 100_000_000) for n in range(4)]
    sizes = []

    def odometry(frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        for number, each in enumerate(frames):
            sizes.append(len(each))
            yield posed(each, pose(1.5 * number))

    found = list(posed_frames(iter(later), odometry))
    assert sizes == [360] * 4
    assert [len(each.frame) for each in found] == [560] * 4
    # the first frame has no pose before it, and is placed by the step to the next one
    for each in found:
        assert each.frame.joined[0].main_from_lidar[0, 3] == pytest.approx(
            2.0 + 15.0 * 0.025, abs=0.02
        )


ELEVATION = np.radians(np.arange(-20.0, 11.0, 1.0))


def wall_seen(
    origin: tuple[float, float, float], at_x_m: float
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Return what a lidar at a place sees of a wall across the road, in the car's axes about it."""
    up, around = np.meshgrid(ELEVATION, np.radians(np.arange(-70.0, 70.0, 0.2)), indexing="ij")
    x = np.full_like(up, at_x_m - origin[0])
    y = x * np.tan(around)
    seen = np.stack([x, y, np.hypot(x, y) * np.tan(up)], axis=-1).reshape(-1, 3)
    ring = np.repeat(np.arange(len(ELEVATION)), up.shape[1]).astype(np.int16)
    return seen.astype(np.float32), ring


def two_lidars() -> LidarFrame:
    """Return a roof lidar that sees a wall at 20 m, and one 3 m to the left with one at 40 m."""
    roof, ring = wall_seen((0, 0, 0), 20.0)
    side, side_ring = wall_seen((0, 3, -1), 40.0)
    there = np.eye(4)
    there[:3, 3] = 0.0, 3.0, -1.0
    points = np.concatenate([roof, side + there[:3, 3].astype(np.float32)])
    made = frame(points, ring=np.concatenate([ring, side_ring]))
    return replace(made, joined=(JoinedLidar("/side", len(side), made.stamp_ns, there),))


def test_rays_of_a_further_lidar_start_at_that_lidar() -> None:
    made = two_lidars()
    (view,) = LidarViews()(made, made.points_m, np.arange(len(made)), np.eye(4))
    # below and beside the roof lidar: only the rays of the lidar at the side pass these places
    places = np.array([[15.0, 3.0, -1.0], [36.0, 3.0, -1.0], [40.0, 3.0, -1.0], [45.0, 3.0, -1.0]])
    seen = visibility(places.astype(np.float32), view.beams_from_odom, view.image, view.table)
    assert seen.tolist() == [FREE, FREE, OCCUPIED, HIDDEN]
    # the same returns with rays from the roof lidar would claim other places
    np.testing.assert_allclose(np.linalg.inv(view.beams_from_odom)[:3, 3], [0.0, 3.0, -1.0])


def test_no_place_is_free_that_only_rays_from_another_lidar_would_pass() -> None:
    made = two_lidars()
    far = made.points_of(0)
    # the lidar at the side sees a piece of the wall at 40 m, and nothing to the right of it
    seen = np.ones(len(made), np.bool_)
    seen[far] = made.points_m[far][:, 1] > 2.0
    lidar = replace(made.joined[0], points=int(seen[far].sum()))
    part = replace(made.part(np.flatnonzero(seen)), joined=(lidar,))  # type: ignore[arg-type]
    (view,) = LidarViews()(part, part.points_m, np.arange(len(part)), np.eye(4))
    parked = np.array([[20.0, 1.5, -0.5]], np.float32)
    answer = visibility(parked, view.beams_from_odom, view.image, view.table)
    assert answer.tolist() == [HIDDEN]
    # its returns taken for returns of rays from the roof would claim that nothing is parked there
    of_roof = range_image(part.points_m[part.main_points :], view.table)
    assert visibility(parked, np.eye(4), of_roof, view.table).tolist() == [FREE]


def test_what_any_lidar_saw_at_a_place_counts_more_than_rays_beyond_it() -> None:
    made = two_lidars()
    views = LidarViews()(made, made.points_m, np.arange(len(made)), np.eye(4))
    places = np.array([[40.0, 3.0, -1.0]] * 3, np.float32)
    codes = np.array([FREE, HIDDEN, OCCUPIED], np.int8)
    assert with_views(codes, places, views).tolist() == [OCCUPIED] * 3
    between = np.array([[15.0, 3.0, -1.0]] * 3, np.float32)
    assert with_views(codes, between, views).tolist() == [FREE, FREE, OCCUPIED]
    assert with_views(codes, between, ()) is codes


class Rings:
    """Stream that says for each point whether its lidar is the main one: it sees one at a time."""

    task = MOTION
    version = "rings@1"
    class_names = ()

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        held: list[PosedFrame] = []
        for each in frames:
            held.append(each)  # two at a time, as networks on a GPU run
            if len(held) == 2:
                yield from (self._label(one) for one in held)
                held = []
        yield from (self._label(one) for one in held)

    def _label(self, each: PosedFrame) -> FrameLabels:
        assert each.frame.joined == ()
        far = np.linalg.norm(each.odom_from_sensor[:3, 3]) > 1.0
        labels = np.full(len(each.frame), far, np.uint8)
        return FrameLabels(labels, np.ones(len(labels), np.float16))


def test_a_network_labels_each_lidar_for_itself() -> None:
    made, _, _ = joined()
    silent = replace(made.main(), joined=(replace(made.joined[0], points=0),))
    given = [posed(each) for each in (made, silent, made, made, made)]
    said = list(labels_of_lidars(Rings(), iter(given)))
    assert [len(each.labels) for each in said] == [560, 360, 560, 560, 560]
    for each in said:
        assert (each.labels[:360] == 0).all()
        assert (each.labels[360:] == 1).all()


def test_one_lidar_is_labelled_as_it_is() -> None:
    alone = [posed(frame(world(50, 3), at_s=n / 10)) for n in range(3)]
    said = list(labels_of_lidars(Rings(), iter(alone)))
    assert [len(each.labels) for each in said] == [50] * 3
