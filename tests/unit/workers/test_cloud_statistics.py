"""Statistics of clouds that depend on the weather, against plain numpy, and in simulated rain."""

from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import convolve

from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame
from schemas.surroundings import CloudStatistics
from tests import factories
from workers.contradiction.cloud_statistics import cloud_statistics
from workers.lab.simulation.sensor.lidar import Lidar, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.weather import Weather


def _labelled(frame: LidarFrame) -> LabelledFrame:
    unknown = factories.said(np.zeros(len(frame)))
    return LabelledFrame(factories.posed(frame), unknown, unknown, np.zeros(len(frame), np.uint8))


def _of(*frames: LidarFrame) -> CloudStatistics | None:
    return cloud_statistics([_labelled(each) for each in frames])


def _cloud(rng: np.random.Generator, count: int = 5_000) -> LidarFrame:
    """Points on walls and in the air, some without a return."""
    walls = rng.uniform((-30, 6, -2), (30, 6.5, 3), (count, 3))
    air = rng.uniform((-12, -12, -5), (12, 12, 5), (60, 3))
    points = np.concatenate([walls, air]).astype(np.float32)
    valid = rng.random(len(points)) < 0.9
    points[~valid] = 0.0
    return replace(
        factories.frame(points),
        valid_mask=valid,
        intensity=rng.random(len(points)).astype(np.float32),
        ring=rng.integers(0, 16, len(points)).astype(np.int16),
    )


def _airborne(frame: LidarFrame) -> tuple[int, int]:
    """Count near returns, and those with at most one other in the cells around them."""
    points = frame.points_m[frame.valid_mask]
    near = points[(np.abs(points) < (10.0, 10.0, 5.0)).all(axis=1)]
    cell = ((near + np.array((10.0, 10.0, 5.0), np.float32)) / np.float32(0.5)).astype(int)
    counts = np.zeros((40, 40, 20), int)
    np.add.at(counts, tuple(cell.T), 1)
    around = convolve(counts, np.ones((3, 3, 3), int), mode="constant")
    return len(near), int((around[tuple(cell.T)] <= 2).sum())


def test_they_are_those_of_plain_numpy() -> None:
    frames = [_cloud(np.random.default_rng(seed)) for seed in range(4)]
    found = _of(*frames)
    assert found is not None
    valid = [each.valid_mask for each in frames]
    points = np.concatenate([f.points_m[v] for f, v in zip(frames, valid, strict=True)])
    assert found.returns == round(len(points) / 4)
    ranges = np.linalg.norm(points, axis=1)
    assert found.range_m == pytest.approx(np.median(ranges), abs=0.06)
    bright = np.concatenate([f.intensity[v] for f, v in zip(frames, valid, strict=True)])
    assert found.intensity == pytest.approx(np.median(bright), abs=0.002)
    near, airborne = np.sum([_airborne(each) for each in frames], axis=0)
    assert airborne > 20
    assert found.airborne_share == pytest.approx(airborne / near, abs=1e-5)
    fired = sum(16 * int(np.bincount(f.ring[v]).max()) for f, v in zip(frames, valid, strict=True))
    assert found.missing_share == pytest.approx(1.0 - len(points) / fired, abs=1e-5)


@pytest.mark.parametrize(
    ("changes", "absent"),
    [
        ({"intensity": np.zeros(5_060, np.float32)}, "intensity"),
        ({"ring": np.full(5_060, -1, np.int16)}, "missing_share"),
        ({"ring": np.full(5_060, 3, np.int16)}, "missing_share"),
        ({"ring": np.full(5_060, 30_000, np.int16)}, "missing_share"),
    ],
)
def test_what_a_log_does_not_record_is_absent(changes: dict[str, Any], absent: str) -> None:
    found = _of(replace(_cloud(np.random.default_rng(1)), **changes))
    assert found is not None
    assert absent not in found.model_dump()
    assert len(found.model_dump()) == 4


def test_a_scene_without_a_return_has_none() -> None:
    empty = replace(factories.frame(np.zeros((3, 3), np.float32)), valid_mask=np.zeros(3, np.bool_))
    assert _of(empty, factories.frame(np.zeros((0, 3), np.float32))) is None


def test_points_at_the_ends_of_the_earth_stay_inside_the_bins() -> None:
    far = np.array([[9_999.0, 9_999.0, 9_999.0], [-1e4, 0, 0], [10.0, -10.0, 5.0]], np.float32)
    assert _of(replace(factories.frame(far), intensity=np.ones(3, np.float32))) is not None


def test_rain_returns_beams_in_the_air() -> None:
    lidar = Lidar(columns=900)
    dry_street = build_street(7, seconds=2.0)
    shares = []
    for rain in (0.0, 0.002, 0.01):
        street = replace(dry_street, weather=Weather(rain_share=rain, stray_share=2e-5))
        simulated = sweep(street, lidar, 3)
        found = _of(factories.frame(simulated.points_m))
        assert found is not None
        shares.append(found.airborne_share)
    dry, drizzle, rain = shares
    assert dry < 0.0005
    assert drizzle > 4 * dry + 0.0003
    assert rain > 3 * drizzle


def test_a_frame_of_a_hundred_thousand_points_takes_two_milliseconds_at_most() -> None:
    frame = _labelled(_cloud(np.random.default_rng(2), 100_000))
    cloud_statistics([frame])
    took_s = []
    for _ in range(10):
        began_s = process_time()
        cloud_statistics([frame])
        took_s.append(process_time() - began_s)
    assert min(took_s) < 0.002
