"""Where beams meet, in clouds that do not say which beam saw what."""

from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.labels import Blindness, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import frame
from workers.ingest.read import read_shard
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.simulation.sensor.lidar import UNEVEN_64, UNIFORM_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.lidar.beam_origin import MAX_HIDDEN_SHARE, hidden_share
from workers.lidar.beam_table import estimate_beam_table
from workers.odometry.odometry import KissOdometry
from workers.selfsupervised.stream import Registration

EVEN_16 = tuple(np.linspace(15.0, -15.0, 16).tolist())
EVEN_32 = tuple(np.linspace(10.67, -30.67, 32).tolist())
TABLES = {"16": EVEN_16, "32": EVEN_32, "64": UNIFORM_64, "64 uneven": UNEVEN_64}
SHIFTS = [(0.78, 0.0, 1.86), (1.41, 0.0, 1.6), (4.0, 0.0, 2.5), (0.0, 0.0, 1.73)]
"""From the middle of the axles, the rear axle, the axle of a lorry, the road under the lidar."""

ZERO = np.zeros(3)
FRAMES = 10


def unknown(points: NDArray[np.float32]) -> NDArray[np.int16]:
    return np.full(len(points), -1, np.int16)


@cache
def drive(table: str, frames: int = 1) -> tuple[SimulatedFrame, ...]:
    lidar = Lidar(elevation_deg=TABLES[table], columns=900)
    world = build_street(3, seconds=FRAMES * lidar.period_s, style="drives")
    return tuple(sweep(world, lidar, index) for index in range(frames))


@pytest.mark.parametrize("table", TABLES)
def test_from_where_the_beams_meet_next_to_nothing_hides_anything(table: str) -> None:
    points = drive(table)[0].points_m
    assert hidden_share(points, ZERO) < 0.5 * MAX_HIDDEN_SHARE
    for shift in SHIFTS:
        assert hidden_share(points, -np.array(shift)) > MAX_HIDDEN_SHARE
    found = estimate_beam_table(points, unknown(points))
    assert found.trusted
    np.testing.assert_array_equal(found.origin_m, ZERO)


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("table", TABLES)
def test_the_place_is_found_in_the_space_of_the_car(
    table: str, shift: tuple[float, float, float]
) -> None:
    points = (drive(table)[0].points_m + np.array(shift)).astype(np.float32)
    found = estimate_beam_table(points, unknown(points))
    assert found.trusted, found.reason
    np.testing.assert_allclose(found.origin_m, shift, atol=0.1)


def test_clouds_of_two_sensors_are_refused_with_a_reason() -> None:
    points = drive("64")[0].points_m
    merged = np.concatenate([points[::2], points[1::2] + np.array([0.5, 0.6, -0.8], np.float32)])
    found = estimate_beam_table(merged, unknown(merged))
    assert not found.trusted
    assert "hide each other" in found.reason
    assert len(found.tangents) > 0


def test_a_stream_of_such_clouds_judges_nothing_and_says_why() -> None:
    some = np.random.default_rng(2)
    frames = []
    for seen in drive("32", 2):
        aside = some.random(len(seen)) < 0.5
        points = seen.points_m + aside[:, None] * np.array([0.5, 0.6, -0.8], np.float32)
        frames.append(frame(points, at_s=seen.time_s))
    for answer in Registration()(KissOdometry()(frames)):
        assert answer.health.blindness is Blindness.NO_BEAMS
        assert "hide each other" in answer.health.reason
        assert (answer.labels == MotionLabel.UNKNOWN).all()


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5000, 3), 7.0), np.eye(3)])
def test_a_cloud_that_tells_nothing_is_no_reason_to_move_the_origin(
    points: NDArray[np.float64],
) -> None:
    assert hidden_share(points, ZERO) == 0.0


def first_cloud(reference: Path, vehicle: str) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    settings = MiningSettings(
        bucket=(reference / "data" / "logs" / vehicle).as_uri(), artifacts="memory://"
    )
    bucket = open_bucket(settings.bucket)
    (recording,) = group_recordings(bucket.list())
    (shard,) = shards_of_log(bucket, recording, settings)
    (first,) = islice(read_shard(bucket, recording, shard, settings).frames(), 1)
    return first.points_m[first.valid_mask], first.ring[first.valid_mask]


@pytest.mark.reference
def test_two_stacked_lidars_in_the_space_of_the_car_are_found_without_their_beams(
    reference: Path,
) -> None:
    points, ring = first_cloud(reference, "av2")
    with_rings = estimate_beam_table(points, ring)
    without = estimate_beam_table(points, unknown(points))
    assert without.trusted, without.reason
    np.testing.assert_allclose(without.origin_m, with_rings.origin_m, atol=0.1)
    assert with_rings.origin_m[2] > 1.5


@pytest.mark.reference
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), *SHIFTS])
def test_a_real_street_moved_into_the_space_of_the_car_is_found_to_be(
    shift: tuple[float, float, float], reference: Path
) -> None:
    points, _ = first_cloud(reference, "pandaset")
    moved = (points + np.array(shift)).astype(np.float32)
    found = estimate_beam_table(moved, unknown(moved))
    assert found.trusted, found.reason
    np.testing.assert_allclose(found.origin_m, shift, atol=0.05)


@pytest.mark.reference
@pytest.mark.parametrize("vehicle", ["kitti/annieway-kitti/2011-10-03", "kitti360"])
def test_lidars_whose_clouds_have_no_beams_keep_their_own_origin(
    vehicle: str, reference: Path
) -> None:
    points, ring = first_cloud(reference, vehicle)
    assert (ring < 0).all()
    found = estimate_beam_table(points, ring)
    assert found.trusted
    np.testing.assert_array_equal(found.origin_m, ZERO)
