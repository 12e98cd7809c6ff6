"""What is learned of a sensor from its own clouds: beams, where they meet, how high it stands."""

from functools import cache

import numpy as np
import pytest

from schemas.frame import LidarFrame
from schemas.labels import Blindness, FrameLabels, MotionLabel
from tests.factories import frame
from workers.lab.simulation.sensor.lidar import UNEVEN_64, UNIFORM_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.lidar.beam_table import estimate_beam_table
from workers.lidar.sensor_height import estimate_sensor_height
from workers.odometry.odometry import KissOdometry
from workers.selfsupervised.stream import Registration

EVEN_16 = tuple(np.linspace(15.0, -15.0, 16).tolist())
EVEN_32 = tuple(np.linspace(10.67, -30.67, 32).tolist())
EVEN_128 = tuple(np.linspace(22.5, -22.5, 128).tolist())
UNEVEN_32 = (
    *(15.0, 10.33, 7.0, 4.667, 3.333),
    *np.arange(2.333, -4.1, -1 / 3).tolist(),
    *(-4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639),
)
"""Dense around the horizon, like many of 32 beams."""

TABLES = {
    "16": EVEN_16,
    "32": EVEN_32,
    "32 uneven": UNEVEN_32,
    "64": UNIFORM_64,
    "64 uneven": UNEVEN_64,
    "128": EVEN_128,
}
FRAMES = 10


@cache
def drive(table: str) -> tuple[SimulatedFrame, ...]:
    lidar = Lidar(elevation_deg=TABLES[table], columns=400)
    world = build_street(3, seconds=FRAMES * lidar.period_s, style="drives")
    return tuple(sweep(world, lidar, index) for index in range(FRAMES))


def frame_of(seen: SimulatedFrame, *, ring: bool = True) -> LidarFrame:
    beams = seen.ring.astype(np.int16) if ring else np.full(len(seen), -1, np.int16)
    return frame(seen.points_m, at_s=seen.time_s, ring=beams)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.7, 0.0, 1.86), (1.5, 0.2, -1.0)])
@pytest.mark.parametrize("table", TABLES)
def test_beams_and_where_they_meet_are_measured(
    table: str, origin: tuple[float, float, float]
) -> None:
    seen = drive(table)[3]
    points = seen.points_m + np.array(origin, np.float32)
    found = estimate_beam_table(points, seen.ring.astype(np.int16))
    assert found.trusted, found.reason
    np.testing.assert_allclose(found.origin_m, origin, atol=0.02)
    beams = np.unique(seen.ring)
    angles = np.sort(np.radians(np.array(TABLES[table])[beams]))
    np.testing.assert_allclose(np.arctan(found.tangents), angles, atol=np.radians(0.02))


@pytest.mark.parametrize("table", TABLES)
def test_the_height_over_the_road_is_measured(table: str) -> None:
    assert estimate_sensor_height(drive(table)[0].points_m) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("spoiled", ["scrambled", "one place", "few"])
def test_beams_that_cannot_be_trusted_are_refused_with_a_reason(spoiled: str) -> None:
    seen = drive("64")[0]
    points, ring = seen.points_m, seen.ring.astype(np.int16)
    if spoiled == "scrambled":
        ring = np.random.default_rng(0).permutation(ring)
    elif spoiled == "one place":
        points = np.full_like(points, 7.0)
    else:
        points, ring = points[:10], ring[:10]
    found = estimate_beam_table(points, ring)
    assert not found.trusted
    assert found.reason


def labels_of(frames: list[LidarFrame]) -> list[FrameLabels]:
    return list(Registration()(KissOdometry()(frames)))


@pytest.mark.parametrize("ring", [True, False], ids=["with rings", "without rings"])
@pytest.mark.parametrize("table", TABLES)
def test_what_moves_is_found_with_any_table_and_what_stands_stays(table: str, ring: bool) -> None:
    """Of what is within 25 m, where 16 beams still put some points on a car."""
    seen = drive(table)[-1]
    answer = labels_of([frame_of(each, ring=ring) for each in drive(table)])[-1]
    near = np.hypot(seen.points_m[:, 0], seen.points_m[:, 1]) < 25.0
    moves, said = near & (seen.motion == 2), answer.labels == MotionLabel.DYNAMIC
    assert answer.health.blindness is None
    assert answer.health.seen_share > 0.6
    assert (said & moves).sum() > 0.5 * moves.sum() > 0
    assert (said & near & (seen.motion == 1)).sum() < 0.03 * near.sum()


def test_a_frame_whose_beams_are_no_cones_says_so_and_judges_nothing() -> None:
    frames = [frame_of(each) for each in drive("64")]
    some = np.random.default_rng(4)
    scrambled = [
        frame(each.points_m, stamp_ns=each.stamp_ns, ring=some.permutation(each.ring))
        for each in frames
    ]
    for answer in labels_of(scrambled):
        assert (answer.labels == MotionLabel.UNKNOWN).all()
        assert answer.health.blindness is Blindness.NO_BEAMS
        assert "no cones" in answer.health.reason
