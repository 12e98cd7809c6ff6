"""Place of a scene from recorded fixes and poses, and in its record."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import PosedFrame, RecordedFix
from schemas.surroundings import EARTH, METRES_PER_DEGREE, ScenePlace
from tests import factories
from workers.contradiction.scene_place import scene_place

MUNICH = (48.137, 11.575)
HEADING_RAD = 2.2


def on_earth(east_m: float, north_m: float) -> tuple[float, float]:
    cos = math.cos(math.radians(MUNICH[0]))
    return (
        MUNICH[0] + north_m / METRES_PER_DEGREE,
        MUNICH[1] + east_m / METRES_PER_DEGREE / cos,
    )


def drive(
    *,
    m_per_s: float = 10.0,
    heading_rad: float = HEADING_RAD,
    every: int = 2,
    at: Callable[[float, float], tuple[float, float]] = on_earth,
    frame: str = EARTH,
    noise_m: float = 0.0,
    yaw_rad: float = 0.3,
) -> Scene:
    """A straight drive of 2 s from a place; odom space is turned by `yaw_rad` to the drive."""
    rng = np.random.default_rng(3)
    frames = []
    for number in range(20):
        way_m = m_per_s * number / 10
        pose = factories.pose(way_m * math.cos(-yaw_rad), way_m * math.sin(-yaw_rad), 0.0)
        fixes: tuple[RecordedFix, ...] = ()
        if number % every == 0:
            off = rng.normal(0.0, noise_m, 2) if noise_m else np.zeros(2)
            place = at(
                way_m * math.cos(heading_rad) + off[0], way_m * math.sin(heading_rad) + off[1]
            )
            fixes = (RecordedFix(factories.BEGIN_NS + number * 100_000_000, frame, place),)
        frames.append(_labelled(number, pose, fixes))
    return factories.scene(frames)


def _labelled(
    number: int, pose: NDArray[np.float64], fixes: tuple[RecordedFix, ...]
) -> LabelledFrame:
    cloud = replace(factories.frame([[5.0, 0.0, 0.0]], at_s=number / 10), fixes=fixes)
    said = factories.said([0])
    return LabelledFrame(PosedFrame(cloud, pose), said, said, np.zeros(1, np.uint8))


def metres_from_munich(place: ScenePlace) -> tuple[float, float]:
    assert place.latitude_deg is not None
    assert place.longitude_deg is not None
    cos = math.cos(math.radians(MUNICH[0]))
    return (
        (place.longitude_deg - MUNICH[1]) * METRES_PER_DEGREE * cos,
        (place.latitude_deg - MUNICH[0]) * METRES_PER_DEGREE,
    )


@pytest.mark.parametrize("heading_rad", [HEADING_RAD, 0.0, -3.0])
def test_it_is_where_the_car_was_at_the_middle_and_says_where_it_drove(heading_rad: float) -> None:
    place = scene_place(drive(heading_rad=heading_rad))
    assert place is not None
    east_m, north_m = metres_from_munich(place)
    assert (east_m, north_m) == pytest.approx(
        (9.5 * math.cos(heading_rad), 9.5 * math.sin(heading_rad)), abs=0.2
    )
    assert place.heading_rad == pytest.approx(heading_rad, abs=0.01)
    turned = (heading_rad + 0.3 + math.pi) % (2 * math.pi) - math.pi
    assert place.odom_yaw_rad == pytest.approx(turned, abs=0.01)
    assert place.odom_m == pytest.approx((9.5 * math.cos(0.3), -9.5 * math.sin(0.3)), abs=0.06)
    assert set(place.model_dump()) == {
        *("latitude_deg", "longitude_deg", "odom_m", "odom_yaw_rad", "heading_rad")
    }


def test_noise_of_a_receiver_is_averaged_over_the_path() -> None:
    place = scene_place(drive(noise_m=1.5, every=1))
    assert place is not None
    away = math.dist(
        metres_from_munich(place), (9.5 * math.cos(HEADING_RAD), 9.5 * math.sin(HEADING_RAD))
    )
    assert away < 1.0
    assert place.heading_rad == pytest.approx(HEADING_RAD, abs=0.25)


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(drive(m_per_s=0.0), id="stands"),
        pytest.param(drive(m_per_s=2.0), id="creeps"),
        pytest.param(drive(every=40), id="a single fix"),
        pytest.param(drive(noise_m=9.0, every=1), id="fixes off the path"),
        pytest.param(drive(at=lambda x, y: on_earth(0.0, 0.0)), id="a frozen receiver"),
    ],
)
def test_without_a_direction_it_is_the_nearest_fix(scene: Scene) -> None:
    place = scene_place(scene)
    assert place is not None
    assert (place.heading_rad, place.odom_yaw_rad) == (None, None)
    fixes = [fix for each in scene.frames for fix in each.posed.frame.fixes]
    middle_ns = (scene.start_ns + scene.end_ns) // 2
    nearest = min(fixes, key=lambda fix: abs(fix.time_ns - middle_ns))
    assert (place.latitude_deg, place.longitude_deg) == pytest.approx(nearest.at, abs=1e-6)


def test_a_frame_in_metres_is_named() -> None:
    place = scene_place(drive(at=lambda x, y: (690_000.0 + x, 5_334_000.0 + y), frame="utm"))
    assert place is not None
    assert (place.frame, place.latitude_deg) == ("utm", None)
    assert place.x_m == pytest.approx(690_000.0 + 9.5 * math.cos(HEADING_RAD), abs=0.1)
    assert place.y_m == pytest.approx(5_334_000.0 + 9.5 * math.sin(HEADING_RAD), abs=0.1)


@pytest.mark.parametrize("longitude", [180.0, -179.99999])
def test_across_the_date_line_and_at_a_pole_numbers_stay_in_bounds(longitude: float) -> None:
    def beyond(east_m: float, north_m: float) -> tuple[float, float]:
        turned = longitude + east_m / METRES_PER_DEGREE
        return north_m / METRES_PER_DEGREE, (turned + 180.0) % 360.0 - 180.0

    place = scene_place(drive(at=beyond))
    assert place is not None
    assert place.heading_rad == pytest.approx(HEADING_RAD, abs=0.01)
    assert scene_place(drive(at=lambda x, y: (90.0, x / 1e5))) is not None


def test_without_fixes_near_the_middle_there_is_none() -> None:
    scene = drive(every=40)
    late = replace(
        scene.frames[0].posed.frame,
        fixes=(RecordedFix(scene.start_ns - 10**10, EARTH, MUNICH),),
    )
    frames = (replace(scene.frames[0], posed=replace(scene.frames[0].posed, frame=late)),)
    assert scene_place(replace(scene, frames=(*frames, *scene.frames[1:]))) is None


def test_of_two_frames_the_nearest_fix_decides() -> None:
    scene = drive()
    first = scene.frames[0]
    mixed = replace(first.posed.frame, fixes=(RecordedFix(first.stamp_ns, "map", (1.0, 2.0)),))
    frames = (replace(first, posed=replace(first.posed, frame=mixed)), *scene.frames[1:])
    place = scene_place(replace(scene, frames=frames))
    assert place is not None
    assert place.frame == EARTH
    assert place.heading_rad == pytest.approx(HEADING_RAD, abs=0.01)


def test_the_coordinates_are_those_of_the_frame() -> None:
    with pytest.raises(ValueError, match="a place has latitude and longitude, or a named frame"):
        ScenePlace(latitude_deg=1.0, odom_m=(0.0, 0.0))
    with pytest.raises(ValueError, match="a place has latitude and longitude, or a named frame"):
        ScenePlace(frame="map", latitude_deg=1.0, longitude_deg=1.0, odom_m=(0.0, 0.0))
