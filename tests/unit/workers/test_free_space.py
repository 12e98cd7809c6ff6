import numpy as np
import pytest
from numpy.typing import NDArray

from workers.free_space import FREE, FREE_IF_TALL, HIDDEN, OCCUPIED, Votes, count_votes, visibility
from workers.lidar.beam_image import COLUMNS, range_image
from workers.lidar.beam_table import BeamTable, estimate_beam_table

ELEVATIONS_DEG = np.arange(-10.0, 5.0, 0.5)
TABLE = BeamTable(
    tangents=np.tan(np.radians(ELEVATIONS_DEG)).astype(np.float32),
    origin_m=np.zeros(3),
    max_gap=float(np.tan(np.radians(1.6))),
)


def wall(distance_m: float, *, half_width_m: float = 30.0) -> NDArray[np.float32]:
    """What the beams see of a wall across the road."""
    elevation, azimuth = np.meshgrid(
        np.radians(ELEVATIONS_DEG), np.radians(np.arange(-60.0, 60.0, 0.2)), indexing="ij"
    )
    x = np.full_like(azimuth, distance_m)
    y = distance_m * np.tan(azimuth)
    z = np.hypot(x, y) * np.tan(elevation)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    seen: NDArray[np.float32] = points[np.abs(points[:, 1]) < half_width_m].astype(np.float32)
    return seen


IMAGE = range_image(wall(20.0), TABLE)


def ask(
    *place: float, image: NDArray[np.float32] = IMAGE, pose: NDArray[np.float64] | None = None
) -> int:
    sensor_from_points = np.eye(4) if pose is None else pose
    places = np.array([place], np.float32)
    return int(visibility(places, sensor_from_points, image, TABLE)[0])


def test_a_place_in_front_of_what_was_seen_was_free() -> None:
    assert ask(10.0, 0.0, 0.0) == FREE


def test_a_place_on_what_was_seen_was_occupied() -> None:
    assert ask(20.0, 1.0, 0.0) == OCCUPIED
    assert ask(20.3, 1.0, 0.0) == OCCUPIED


def test_a_place_behind_what_was_seen_is_hidden() -> None:
    assert ask(30.0, 0.0, 0.0) == HIDDEN


def test_a_place_hardly_in_front_of_what_was_seen_is_not_called_free() -> None:
    assert ask(19.5, 0.0, 0.0) == HIDDEN


@pytest.mark.parametrize(
    "place",
    [
        pytest.param((10.0, 0.0, 5.0), id="above the beams"),
        pytest.param((10.0, 0.0, -4.0), id="below the beams"),
        pytest.param((-10.0, 0.0, 0.0), id="where nothing came back"),
    ],
)
def test_nothing_is_known_of_a_place_that_no_beam_reached(
    place: tuple[float, float, float],
) -> None:
    assert ask(*place) == HIDDEN


def test_places_are_asked_from_where_the_sensor_was() -> None:
    sensor_from_points = np.eye(4)
    sensor_from_points[0, 3] = -15.0
    assert ask(35.0, 0.0, 0.0, pose=sensor_from_points) == OCCUPIED
    assert ask(25.0, 0.0, 0.0, pose=sensor_from_points) == FREE


def test_the_seam_behind_the_car_is_no_wall() -> None:
    behind = wall(20.0) * np.array([-1.0, -1.0, 1.0], np.float32)
    assert ask(-10.0, 0.001, 0.0, image=range_image(behind, TABLE)) == FREE
    assert ask(-10.0, -0.001, 0.0, image=range_image(behind, TABLE)) == FREE


def test_the_nearest_return_counts_in_a_cell() -> None:
    both = range_image(np.concatenate([wall(30.0), wall(20.0)]), TABLE)
    filled = IMAGE > 0
    np.testing.assert_array_equal(both[filled], IMAGE[filled])
    assert ask(25.0, 0.0, 0.0, image=both) == HIDDEN


def test_an_image_has_a_row_per_beam_and_says_nothing_where_nothing_came_back() -> None:
    assert IMAGE.shape == (len(ELEVATIONS_DEG), COLUMNS)
    assert (IMAGE[:, : COLUMNS // 4] == 0).all()


SPARSE = BeamTable(
    tangents=TABLE.tangents[::6], origin_m=np.zeros(3), max_gap=float(np.tan(np.radians(1.6)))
)


def ask_sparse(*place: float, seen: NDArray[np.float32] | None = None) -> int:
    """Ask beams three degrees apart, 0.42 m at 8 m and 0.63 m at 12 m."""
    image = range_image(wall(20.0) if seen is None else seen, SPARSE)
    return int(visibility(np.array([place], np.float32), np.eye(4), image, SPARSE)[0])


def test_beams_half_a_metre_apart_see_that_nothing_tall_was_there() -> None:
    assert ask_sparse(8.0, 0.0, 0.0) == FREE_IF_TALL
    assert ask_sparse(12.0, 0.0, 0.0) == HIDDEN


def test_one_of_two_beams_that_are_far_apart_proves_nothing() -> None:
    seen = wall(20.0)
    below = seen[seen[:, 2] < np.hypot(seen[:, 0], seen[:, 1]) * np.tan(np.radians(-0.5))]
    assert ask_sparse(8.0, 0.0, 0.0, seen=below) == HIDDEN
    assert ask(8.0, 0.0, -0.12, image=range_image(below, TABLE)) == FREE


def test_something_between_beams_that_are_far_apart_is_seen_by_either() -> None:
    assert ask_sparse(20.0, 0.0, 0.0) == HIDDEN
    near = np.concatenate([wall(20.0), wall(8.0, half_width_m=1.0)])
    assert ask_sparse(8.0, 0.0, 0.0, seen=near) == OCCUPIED


def test_beams_far_apart_count_but_not_as_close_ones() -> None:
    votes = count_votes([np.array([FREE_IF_TALL, FREE, FREE_IF_TALL], np.int8)] * 2, 3)
    votes = Votes(votes.free, votes.occupied + np.array([0, 0, 4], np.int16), votes.free_if_tall)
    assert votes.seen_through.tolist() == [True, True, False]
    assert votes.closely_seen_through.tolist() == [False, True, False]


def test_one_frame_that_saw_through_a_place_is_not_enough() -> None:
    answers = [np.array([FREE, FREE, FREE, HIDDEN], np.int8)]
    answers += [np.array([FREE, HIDDEN, OCCUPIED, HIDDEN], np.int8)] * 2
    votes: Votes = count_votes(answers, 4)
    assert votes.free.tolist() == [3, 1, 1, 0]
    assert votes.occupied.tolist() == [0, 0, 2, 0]
    assert votes.known.tolist() == [True, True, True, False]
    assert votes.seen_through.tolist() == [True, False, False, False]


def cones(origin: tuple[float, float, float]) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Returns of 30 beams about an origin, at all kinds of ranges."""
    some = np.random.default_rng(1)
    ring = np.repeat(np.arange(len(ELEVATIONS_DEG)), 400).astype(np.int16)
    azimuth = some.uniform(-np.pi, np.pi, len(ring))
    across = some.uniform(4.0, 50.0, len(ring))
    tangent = np.tan(np.radians(ELEVATIONS_DEG))[ring]
    points = np.stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), across * tangent], axis=-1
    )
    return (points + np.array(origin)).astype(np.float32), ring


def test_recorded_beams_give_their_elevations() -> None:
    table = estimate_beam_table(*cones((0.0, 0.0, 0.0)))
    assert table.trusted
    np.testing.assert_allclose(np.degrees(np.arctan(table.tangents)), ELEVATIONS_DEG, atol=0.01)
    np.testing.assert_array_equal(table.origin_m, 0.0)


def test_a_cloud_in_the_space_of_the_car_gives_the_place_of_the_sensor() -> None:
    table = estimate_beam_table(*cones((1.4, 0.0, 1.6)))
    assert table.trusted
    np.testing.assert_allclose(table.origin_m, [1.4, 0.0, 1.6], atol=0.05)


def test_beams_that_are_no_cones_are_not_trusted() -> None:
    points, ring = cones((0.0, 0.0, 0.0))
    mixed = np.random.default_rng(2).permutation(ring)
    table = estimate_beam_table(points, mixed)
    assert not table.trusted
    assert table.reason


def test_rows_are_found_without_recorded_beams() -> None:
    points = wall(20.0)
    table = estimate_beam_table(points, np.full(len(points), -1, np.int16))
    assert table.trusted
    spacing_deg = np.degrees(np.diff(np.arctan(table.tangents))).mean()
    assert spacing_deg == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("count", [0, 1, 30])
def test_a_cloud_without_beams_is_refused_with_a_reason(count: int) -> None:
    points = np.full((count, 3), 5.0, np.float32)
    table = estimate_beam_table(points, np.full(count, -1, np.int16))
    assert not table.trusted
    assert table.reason
