"""What truth says of a simulated frame beyond labels: flow, attitude, what is in the air."""

from dataclasses import replace

import numpy as np
import pytest

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box
from workers.lab.simulation.sensor.flow import flow_of
from workers.lab.simulation.sensor.lidar import Lidar, sensor_poses, sweep
from workers.lab.simulation.world.motion_along_road import Road, drive_along, stand
from workers.lab.simulation.world.scenery import bump_meshes
from workers.lab.simulation.world.street import Actor, Street
from workers.lab.simulation.world.terrain import Terrain
from workers.lab.simulation.world.weather import Weather

SECONDS = 4.0
STRAIGHT = Road.bending(from_m=-300.0, to_m=300.0, swing_rad=0.0, wave_m=100.0)
LIDAR = Lidar(columns=256, noise_m=0.0, dropout_share=0.0)
WALL = box(1.0, 30.0, 0.0, 8.0, what=StreetClass.BUILDING, material=Material.WALL, x_m=25.0)


def going(*, from_m: float, across_m: float, m_per_s: float) -> Actor:
    speed = [(0.0, m_per_s), (SECONDS, m_per_s)]
    drive = drive_along(
        STRAIGHT,
        from_m=from_m,
        across_m=across_m,
        speed=speed,
        seconds=SECONDS,
        backwards=False,
    )
    return Actor(StreetClass.CAR, drive)


def street(
    *actors: Actor,
    ego_m_per_s: float = 0.0,
    terrain: Terrain | None = None,
    weather: Weather | None = None,
    fixed: tuple[Mesh, ...] = (WALL,),
) -> Street:
    ego = going(from_m=0.0, across_m=0.0, m_per_s=ego_m_per_s).drive
    return Street.of(
        seed=3,
        seconds=SECONDS,
        ego=ego,
        actors=actors,
        fixed=fixed,
        even=True,
        terrain=terrain,
        weather=weather,
    )


def test_what_stands_flows_against_the_ego_and_what_moves_by_its_speed_as_well() -> None:
    parked = Actor(StreetClass.CAR, stand(STRAIGHT, at_m=12.0, across_m=-5.0), parked=True)
    moving = going(from_m=14.0, across_m=4.0, m_per_s=8.0)
    world = street(moving, parked, ego_m_per_s=5.0)
    frame = sweep(world, LIDAR, 6)
    flow = flow_of(world, LIDAR, frame).astype(np.float64)
    assert flow.shape == (len(frame), 3)
    for track, ahead_m in ((-1, -0.5), (1, -0.5), (0, 0.3)):
        mine = flow[frame.track == track]
        np.testing.assert_allclose(
            mine, np.broadcast_to([ahead_m, 0.0, 0.0], mine.shape), atol=0.01
        )
    assert (frame.track == 0).sum() > 30 < (frame.track == 1).sum()


def test_a_mover_is_seen_where_it_is_when_each_beam_is_fired() -> None:
    world = street(going(from_m=14.0, across_m=3.0, m_per_s=20.0))
    frame = sweep(world, replace(LIDAR, columns=1024), 5)
    mine = frame.track == 0
    tail_m = 14.0 + 20.0 * (0.5 + frame.offset_ns[mine] / 1e9) - world.actors[0].size_m[0] / 2
    x_m = frame.points_m[mine, 0]
    assert (x_m - tail_m).min() == pytest.approx(0.0, abs=0.08)
    assert ((x_m - tail_m) > -0.02).all()


def test_going_over_a_bump_the_car_rises_and_nods_and_the_ground_stays_where_it_is() -> None:
    level = Terrain.even()
    bumpy = Terrain(level.slopes, level.waves, np.array([[10.0, 0.0, 0.0, 3.0, 0.12]]))
    world = street(ego_m_per_s=5.0, terrain=bumpy, fixed=tuple(bump_meshes(bumpy)))
    poses = sensor_poses(world, LIDAR, np.linspace(0.0, 4.0, 400))
    assert poses[:, 2, 3].max() - LIDAR.height_m == pytest.approx(0.06, abs=0.02)
    nod = -np.degrees(np.arcsin(poses[:, 2, 0]))
    assert nod.min() < -1.0 < 1.0 < nod.max()
    frame = sweep(world, LIDAR, 4)
    column = frame.offset_ns // (LIDAR.period_ns // LIDAR.columns)
    fired = sensor_poses(world, LIDAR, 0.4 + np.arange(LIDAR.columns) / LIDAR.columns * 0.1)
    at_point = fired[column]
    points = np.einsum("nij,nj->ni", at_point[:, :3, :3], frame.points_m) + at_point[:, :3, 3]
    on_plane = (frame.class_id == StreetClass.ROAD) & (np.abs(points[:, 0] - 10.0) > 1.3)
    near = on_plane & (np.hypot(frame.points_m[:, 0], frame.points_m[:, 1]) < 20.0)
    np.testing.assert_allclose(points[near, 2], 0.0, atol=0.01)
    on_bump = (np.abs(points[:, 0] - 10.0) < 0.5) & (np.abs(points[:, 1]) < 2.5)
    assert points[on_bump, 2].max() > 0.07


def test_rain_and_dust_answer_before_what_is_solid_and_nobody_says_whether_they_move() -> None:
    clear = sweep(street(), LIDAR, 0)
    puff = np.array([[8.0, 0.0, 0.5, 2.0, 0.0, 4.0]])
    wet = sweep(street(weather=Weather(rain_share=0.02, puffs=puff)), LIDAR, 0)
    air = wet.class_id == StreetClass.NOISE
    assert not (clear.class_id == StreetClass.NOISE).any()
    assert 0.005 * len(wet) < air.sum() < 0.2 * len(wet)
    assert (wet.motion[air] == 0).all()
    assert (wet.track[air] == -1).all()
    assert (wet.ground[air] == 255).all()
    dusty = air & (np.linalg.norm(wet.points_m - np.array([8.0, 0.0, -1.5]), axis=1) < 1.2)
    assert dusty.sum() > 5


def test_the_own_roof_hides_the_ground_behind_it() -> None:
    bare, mounted = (replace(LIDAR, roof=roof, height_m=1.8) for roof in (False, True))
    without, with_roof = sweep(street(), bare, 0), sweep(street(), mounted, 0)
    own = with_roof.class_id == StreetClass.EGO
    assert own.sum() > 20
    assert (np.linalg.norm(with_roof.points_m[own], axis=1) < 3.0).all()
    assert (with_roof.motion[own] == 0).all()
    hidden = without.ring == without.ring.max()
    assert (with_roof.ring == without.ring.max()).sum() < hidden.sum()
