"""What all kinds of streets hold, what fleets carry, and what networks are trained on."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from workers.lab.simulation.models.kinds import MOVABLE, StreetClass
from workers.lab.simulation.models.models import models_of
from workers.lab.simulation.output.samples import street_samples
from workers.lab.simulation.sensor.lidar import Lidar, sweep
from workers.lab.simulation.sensor.sensors import SENSORS, SensorName, mounted
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_kinds import PLACES, PlaceName
from workers.lab.simulation.world.street_plan import HARDSHIPS, StreetPlan, draw_plan

LIDAR = Lidar(columns=300)
SIZES_M = {
    StreetClass.CAR: (3.5, 5.2, 1.4, 1.9),
    StreetClass.VAN: (4.8, 6.2, 1.9, 2.8),
    StreetClass.TRUCK: (6.5, 19.0, 2.5, 4.1),
    StreetClass.BUS: (8.0, 19.0, 2.8, 3.3),
    StreetClass.PEDESTRIAN: (0.5, 2.3, 1.1, 2.0),
    StreetClass.CYCLIST: (1.5, 2.0, 1.5, 2.0),
    StreetClass.MOTORCYCLE: (1.9, 2.4, 1.3, 1.9),
    StreetClass.ANIMAL: (0.5, 2.5, 0.4, 2.2),
}


@pytest.mark.parametrize("what", MOVABLE)
def test_models_are_as_large_as_what_they_stand_for_and_touch_the_ground(what: StreetClass) -> None:
    least_long, most_long, least_high, most_high = SIZES_M[what]
    for model in models_of(what):
        length, width, height = model.size_m
        assert least_long < length < most_long, model.name
        assert least_high < height < most_high, model.name
        assert width < 2.7
        for mesh in model.phases:
            assert abs(mesh.corners_m[:, 2].min()) < 0.12, model.name
            assert set(mesh.class_id.tolist()) == {what}


@pytest.mark.parametrize("place", PLACES)
def test_every_kind_of_street_holds_what_belongs_to_it(place: PlaceName) -> None:
    built = build_street(5, seconds=4.0, plan=StreetPlan(place=place, style="drives"))
    frames = [sweep(built, LIDAR, index) for index in (0, 20, 39)]
    seen = Counter(c for frame in frames for c in np.unique(frame.class_id).tolist())
    wanted = {StreetClass.ROAD, StreetClass.VEGETATION, StreetClass.POLE}
    wanted |= {
        "town": {StreetClass.BUILDING, StreetClass.SIDEWALK, StreetClass.CAR},
        "suburb": {StreetClass.BUILDING, StreetClass.SIDEWALK, StreetClass.FENCE},
        "highway": {StreetClass.FENCE, StreetClass.TERRAIN},
        "country": {StreetClass.TERRAIN},
    }[place]
    assert wanted <= set(seen)
    assert any((frame.motion == 2).sum() > 20 for frame in frames)


def test_a_fleets_streets_are_of_all_kinds_and_the_hard_ones_hard() -> None:
    rng = np.random.default_rng(1)
    plain = [draw_plan(rng, hard=False) for _ in range(200)]
    hard = [draw_plan(rng, hard=True) for _ in range(200)]
    assert {each.place for each in plain} == set(PLACES)
    assert all(not each.hard for each in plain)
    assert all(len(each.hard) >= 2 for each in hard)
    assert {hardship for each in hard for hardship in each.hard} == set(HARDSHIPS)
    assert all(each.style == "turns" for each in hard if "turns" in each.hard)


def test_what_is_easily_taken_for_standing_is_there_where_it_is_wanted() -> None:
    built = build_street(5, seconds=6.0, plan=StreetPlan(unsettling=True))
    speed = np.hypot(*built.actor_velocities(3.0).T)
    walks = np.array([a.street_class is StreetClass.PEDESTRIAN for a in built.actors])
    assert (walks & (speed > 0.5) & (speed < 1.0)).sum() >= 2
    assert any(actor.size_m[0] > 18.0 and not actor.parked for actor in built.actors)


def test_no_house_stands_across_a_narrow_street() -> None:
    """Of the corners of one, all were beside the street that its middle stood on."""
    built = build_street(9, seconds=20.0, plan=StreetPlan(place="country", style="turns"))
    time_s = np.arange(0.0, 20.0, 0.1)
    way = np.column_stack([built.ego.pose(time_s)[:, :2], built.ego_bodies(time_s)[:, 2] + 1.0])
    step = np.diff(way, axis=0)
    far_m = np.linalg.norm(step, axis=1)
    goes = far_m > 0.05
    scene = built.standing_scene
    met, _, _ = scene.cast(
        way[:-1][goes].astype(np.float32),
        (step[goes] / far_m[goes, None]).astype(np.float32),
        (far_m[goes] + 0.5).astype(np.float32),
    )
    assert goes.sum() > 100
    assert np.isinf(met).all()


@cache
def _some_street() -> Street:
    return build_street(3, seconds=1.0)


@pytest.mark.parametrize("sensor", SENSORS)
def test_sensors_have_the_beams_they_are_known_for(sensor: SensorName) -> None:
    lidar = mounted(sensor, "roof", columns=200)
    beams = {"hdl32": 32, "vlp32c": 32, "os1-128": 128}.get(sensor, 64)
    assert len(lidar.elevation_deg) == beams
    assert list(lidar.elevation_deg) == sorted(lidar.elevation_deg, reverse=True)
    frame = sweep(_some_street(), lidar, 0)
    # Half a millimetre of rounding is a twentieth of a degree at half a metre.
    solid = np.linalg.norm(frame.points_m, axis=1) > 3.0
    range_m = np.linalg.norm(frame.points_m[solid], axis=1)
    found = np.degrees(np.arcsin(frame.points_m[solid, 2] / range_m))
    table = np.array(lidar.elevation_deg)[frame.ring[solid]]
    np.testing.assert_allclose(found, table, atol=0.04)


def test_training_samples_depend_on_the_seed_alone_and_hold_frames_in_a_row() -> None:
    first, again = (
        list(street_samples(7, streets=1, windows=1, frames=2, columns=100)) for _ in range(2)
    )
    assert len(first) == 1
    for one, two in zip(first, again, strict=True):
        assert one.lidar == two.lidar
        assert [f.index for f in one.frames] == [one.frames[0].index, one.frames[0].index + 1]
        for a, b in zip(one.frames, two.frames, strict=True):
            assert a.points_m.tobytes() == b.points_m.tobytes()
