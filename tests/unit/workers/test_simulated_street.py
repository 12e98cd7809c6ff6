import numpy as np
import pytest

from tests.factories import SMALL_LIDAR
from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, box, limb
from workers.lab.simulation.sensor.lidar import Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.motion_along_road import Floats, Road, drive_along, stand
from workers.lab.simulation.world.street import Actor, Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import EGO_STYLES, EgoStyle
from workers.lab.simulation.world.terrain import ROAD_WAVES

SECONDS = 4.0
STRAIGHT = Road.bending(from_m=-300.0, to_m=300.0, swing_rad=0.0, wave_m=100.0)
EXACT_LIDAR = Lidar(columns=256, noise_m=0.0, dropout_share=0.0)
WALL = box(*(1.0, 30.0, 0.0, 8.0), what=StreetClass.BUILDING, material=Material.WALL, x_m=20.0)


def pole_at(x_m: float, y_m: float, *, radius_m: float) -> Mesh:
    """A round one, to a millimetre."""
    foot, head = (x_m, y_m, 0.0), (x_m, y_m, 5.0)
    what, metal = StreetClass.POLE, Material.METAL
    return limb(foot, head, radius_m, radius_m, what=what, material=metal, sides=60)


def street(
    *actors: Actor, fixed: tuple[Mesh, ...] = (), ego_m_per_s: float = 0.0, even: bool = True
) -> Street:
    ego = drive_along(
        STRAIGHT,
        from_m=0.0,
        across_m=0.0,
        speed=[(0.0, ego_m_per_s), (SECONDS, ego_m_per_s)],
        seconds=SECONDS,
        backwards=False,
    )
    return Street.of(seed=3, seconds=SECONDS, ego=ego, actors=actors, fixed=fixed, even=even)


def driving_car(*, from_m: float, across_m: float, m_per_s: float) -> Actor:
    drive = drive_along(
        STRAIGHT,
        from_m=from_m,
        across_m=across_m,
        speed=[(0.0, m_per_s), (SECONDS, m_per_s)],
        seconds=SECONDS,
        backwards=False,
    )
    return Actor(StreetClass.CAR, drive)


def points_of(frame: SimulatedFrame, what: StreetClass) -> Floats:
    points: Floats = frame.points_m[frame.class_id == what].astype(np.float64)
    return points


def test_points_on_the_wall_are_on_the_wall() -> None:
    frame = sweep(street(fixed=(WALL,)), EXACT_LIDAR, 0)
    on_wall = points_of(frame, StreetClass.BUILDING)
    assert len(on_wall) > 100
    np.testing.assert_allclose(on_wall[:, 0], 19.5, atol=2e-3)
    assert np.abs(on_wall[:, 1]).max() <= 15.0 + 2e-3
    assert on_wall[:, 2].max() <= 8.0 - EXACT_LIDAR.height_m + 2e-3


def test_points_on_the_road_lie_on_the_road() -> None:
    frame = sweep(street(fixed=(WALL,)), EXACT_LIDAR, 0)
    on_road = points_of(frame, StreetClass.ROAD)
    assert len(on_road) > 1000
    np.testing.assert_allclose(on_road[:, 2], -EXACT_LIDAR.height_m, atol=2e-3)
    assert frame.ground[frame.class_id == StreetClass.ROAD].all()


def test_the_road_rises_and_falls_by_centimetres() -> None:
    frame = sweep(street(even=False), EXACT_LIDAR, 0)
    near = np.hypot(*frame.points_m[:, :2].T) < 15.0
    points = frame.points_m[near].astype(np.float64)
    world = points @ frame.world_from_sensor[:3, :3].T + frame.world_from_sensor[:3, 3]
    assert np.abs(world[:, 2]).max() < ROAD_WAVES[:, 0].sum() + 5e-3
    assert world[:, 2].std() > 0.01
    x, y = world[:, :2].T
    expected_m = np.sum([a * np.sin(kx * x + ky * y + at) for a, kx, ky, at in ROAD_WAVES], axis=0)
    np.testing.assert_allclose(world[:, 2], expected_m, atol=0.01)


def test_points_on_a_pole_lie_on_its_skin() -> None:
    pole = pole_at(8.0, 3.0, radius_m=0.25)
    on_pole = points_of(sweep(street(fixed=(pole,)), EXACT_LIDAR, 0), StreetClass.POLE)
    assert len(on_pole) > 20
    np.testing.assert_allclose(np.hypot(on_pole[:, 0] - 8.0, on_pole[:, 1] - 3.0), 0.25, atol=3e-3)


def test_a_wall_hides_what_stands_behind_it() -> None:
    hidden = driving_car(from_m=30.0, across_m=0.0, m_per_s=0.0)
    frame = sweep(street(hidden, fixed=(WALL,)), EXACT_LIDAR, 0)
    assert (frame.track == -1).all()


def test_a_beam_passes_over_a_car_and_under_it() -> None:
    parked = Actor(StreetClass.CAR, stand(STRAIGHT, at_m=12.0, across_m=0.0), parked=True)
    frame = sweep(street(parked, fixed=(WALL,)), EXACT_LIDAR, 0)
    ahead = np.abs(frame.points_m[:, 1]) < 0.5
    beyond = ahead & (frame.points_m[:, 0] > 19.0)
    assert beyond.any()
    road_below = ahead & (frame.class_id == StreetClass.ROAD) & (frame.points_m[:, 0] > 9.8)
    assert (frame.points_m[road_below, 0] < 14.2).any()


def test_a_moving_car_is_dynamic_and_a_parked_one_is_not() -> None:
    moving = driving_car(from_m=10.0, across_m=4.0, m_per_s=6.0)
    parked = Actor(StreetClass.CAR, stand(STRAIGHT, at_m=10.0, across_m=-4.0), parked=True)
    frame = sweep(street(moving, parked, ego_m_per_s=5.0), EXACT_LIDAR, 10)
    assert (frame.motion[frame.track == 0] == 2).all()
    assert (frame.motion[frame.track == 1] == 1).all()
    assert (frame.track == 0).sum() > 50 < (frame.track == 1).sum()
    assert (frame.motion[frame.track == -1] == 1).all()


def test_a_creeping_car_is_unknown() -> None:
    frame = sweep(street(driving_car(from_m=10.0, across_m=4.0, m_per_s=0.35)), EXACT_LIDAR, 10)
    assert (frame.motion[frame.track == 0] == 0).all()


def test_a_moving_sensor_sees_each_point_from_where_it_was_at_that_instant() -> None:
    frame = sweep(street(fixed=(WALL,), ego_m_per_s=10.0), EXACT_LIDAR, 0)
    on_wall = frame.class_id == StreetClass.BUILDING
    travelled_m = 10.0 * frame.offset_ns[on_wall] / 1e9
    np.testing.assert_allclose(frame.points_m[on_wall, 0] + travelled_m, 19.5, atol=5e-3)
    assert np.ptp(travelled_m) > 0.1


def test_the_true_pose_says_where_the_sensor_was_at_the_first_firing() -> None:
    poles = [(-9.0, y) for y in (-1.0, 0.0, 1.0)]
    behind = tuple(pole_at(x, y, radius_m=0.15) for x, y in poles)
    frame = sweep(street(fixed=behind, ego_m_per_s=10.0), EXACT_LIDAR, 8)
    early = (frame.class_id == StreetClass.POLE) & (frame.offset_ns < 5_000_000)
    rotation, origin = frame.world_from_sensor[:3, :3], frame.world_from_sensor[:3, 3]
    world = frame.points_m[early] @ rotation.T + origin
    np.testing.assert_allclose(origin, [8.0, 0.0, EXACT_LIDAR.height_m], atol=1e-6)
    assert len(world) > 10
    nearest_m = np.min([np.hypot(world[:, 0] - x, world[:, 1] - y) for x, y in poles], axis=0)
    np.testing.assert_allclose(nearest_m, 0.15, atol=0.06)


def test_the_lidar_turns_clockwise_from_behind_within_one_period() -> None:
    frame = sweep(street(fixed=(WALL,)), EXACT_LIDAR, 0)
    azimuth = np.arctan2(frame.points_m[:, 1], frame.points_m[:, 0])
    turned = (np.pi - azimuth) % (2 * np.pi)
    assert (np.diff(frame.offset_ns.astype(np.int64)) >= 0).all()
    assert np.ptp(frame.offset_ns) < EXACT_LIDAR.period_ns
    np.testing.assert_allclose(
        turned[1:], frame.offset_ns[1:] / EXACT_LIDAR.period_ns * 2 * np.pi, atol=1e-2
    )


@pytest.mark.parametrize("style", EGO_STYLES)
def test_a_street_depends_on_its_seed_alone(style: EgoStyle) -> None:
    first, again, other = (
        sweep(build_street(seed, seconds=3.0, style=style), SMALL_LIDAR, 7) for seed in (5, 5, 6)
    )
    for name in ("points_m", "intensity", "offset_ns", "ring", "class_id", "track", "motion"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes(), name
    assert first.points_m.tobytes() != other.points_m.tobytes()


@pytest.mark.parametrize("seed", range(4))
def test_a_street_holds_traffic_and_structure_on_most_sides(seed: int) -> None:
    built = build_street(seed, seconds=6.0)
    lidar = Lidar(columns=256)
    frames = [sweep(built, lidar, index) for index in range(0, 60, 12)]
    assert any((frame.motion == 2).sum() > 50 for frame in frames)
    for frame in frames:
        standing = (frame.ground == 0) & (frame.motion == 1)
        azimuth = np.arctan2(frame.points_m[standing, 1], frame.points_m[standing, 0])
        sectors = np.bincount(((azimuth + np.pi) / (2 * np.pi) * 12).astype(int) % 12, minlength=12)
        assert (sectors > 0).sum() >= 7


@pytest.mark.parametrize("seed", range(6))
def test_nothing_drives_through_anything_else(seed: int) -> None:
    built = build_street(seed, seconds=8.0, style=EGO_STYLES[seed % 3])
    thin_m = np.array([min(actor.size_m[:2]) / 2 for actor in built.actors])
    for at_s in np.arange(0.0, 8.0, 0.2):
        places = built.actor_poses(float(at_s))[:, :2]
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        np.fill_diagonal(apart, np.inf)
        assert (apart > thin_m[:, None] + thin_m[None]).all()
        ego = built.ego.pose(float(at_s))[:2]
        assert (np.hypot(*(places - ego).T) > 0.9 + thin_m).all()
