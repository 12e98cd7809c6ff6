"""Places: distances, cells and spots of things, on Earth and in frames of metres."""

import math

import pytest

from schemas.surroundings import EARTH, METRES_PER_DEGREE, ScenePlace
from service.curation.places import (
    CELL_M,
    Spot,
    apart_m,
    name_of_cell,
    spot_in,
    text_of,
    turn_between_rad,
)

MUNICH = Spot(EARTH, 48.137, 11.575)
SPOTS = [
    MUNICH,
    Spot(EARTH, -33.9, -179.9999),
    Spot(EARTH, 0.0, 179.9999),
    Spot(EARTH, 89.9, 3.0),
    Spot("utm", 690_000.0, 5_334_000.0),
]


@pytest.mark.parametrize("spot", SPOTS)
@pytest.mark.parametrize(("first_m", "second_m"), [(0.0, 0.0), (12.0, -5.0), (-90.0, 40.0)])
def test_a_shift_is_a_distance(spot: Spot, first_m: float, second_m: float) -> None:
    away_m = apart_m(spot, spot.shifted(first_m, second_m))
    assert away_m == pytest.approx(math.hypot(first_m, second_m), rel=0.01, abs=1e-3)


@pytest.mark.parametrize("spot", SPOTS)
def test_spots_within_an_edge_lie_in_the_cells_around(spot: Spot) -> None:
    for turn in range(16):
        shift = 19.5 * math.cos(turn), 19.5 * math.sin(turn)
        assert spot.shifted(*shift).cell(20.0) in set(spot.cells_around(20.0))


def test_spots_of_two_frames_are_never_near() -> None:
    assert apart_m(Spot("map", 0.0, 0.0), Spot("utm", 0.0, 0.0)) == math.inf


def test_a_thing_is_placed_by_the_turn_of_its_odom_space() -> None:
    place = ScenePlace(
        latitude_deg=48.137, longitude_deg=11.575, odom_m=(100.0, 50.0), odom_yaw_rad=math.pi / 2
    )
    spot = spot_in(place, (110.0, 50.0))
    assert spot is not None
    assert (spot.first - 48.137) * METRES_PER_DEGREE == pytest.approx(10.0, abs=0.01)
    assert spot.second == pytest.approx(11.575, abs=1e-7)
    metric = ScenePlace(frame="utm", x_m=5.0, y_m=6.0, odom_m=(0.0, 0.0), odom_yaw_rad=0.0)
    assert spot_in(metric, (2.0, 1.0)) == Spot("utm", 7.0, 7.0)
    assert spot_in(metric.model_copy(update={"odom_yaw_rad": None}), (2.0, 1.0)) is None


def test_cells_have_names_and_places_have_coordinates() -> None:
    place = ScenePlace(latitude_deg=48.137123, longitude_deg=11.575456, odom_m=(0.0, 0.0))
    assert text_of(place) == "48.137123, 11.575456"
    south, west = map(float, name_of_cell(place).split())
    assert 0.0 <= (48.137123 - south) * METRES_PER_DEGREE <= CELL_M + 6
    assert (
        0.0 <= (11.575456 - west) * METRES_PER_DEGREE * math.cos(math.radians(48.1)) <= CELL_M + 6
    )
    metric = ScenePlace(frame="utm", x_m=251.0, y_m=-1.0, odom_m=(0.0, 0.0))
    assert (text_of(metric), name_of_cell(metric)) == ("utm 251.0, -1.0", "utm 200 -100")
    assert name_of_cell(None) == ""


def test_an_angle_between_directions_has_no_seam() -> None:
    assert turn_between_rad(3.1, -3.1) == pytest.approx(2 * math.pi - 6.2)
    assert turn_between_rad(0.0, math.pi) == pytest.approx(math.pi)
