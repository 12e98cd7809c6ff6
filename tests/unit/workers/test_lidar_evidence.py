"""Choosing the lidars of a log by what their clouds look like."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader

from schemas.work import Channel
from workers.ingest.lidar import choose_lidars, lidar_properties
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import DecodedCloud, decode_cloud


def cloud(
    points: int,
    *,
    azimuth_deg: tuple[float, float] = (-180, 180),
    elevation_deg: tuple[float, float] = (-25, 3),
    frame_id: str = "lidar",
    stamp_ns: int = 1,
    extra: str = "intensity",
) -> DecodedCloud:
    """Spread points at 10 m over a part of the sphere around the sensor."""
    rng = np.random.default_rng(points)
    azimuth = np.deg2rad(rng.uniform(*azimuth_deg, points))
    elevation = np.deg2rad(rng.uniform(*elevation_deg, points))
    return DecodedCloud(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        points=points,
        height=1,
        fields={
            "x": (10 * np.cos(azimuth) * np.cos(elevation)).astype(np.float32),
            "y": (10 * np.sin(azimuth) * np.cos(elevation)).astype(np.float32),
            "z": (10 * np.sin(elevation)).astype(np.float32),
            extra: np.zeros(points, dtype=np.float32),
        },
        data=b"",
    )


SPINNING = lidar_properties([cloud(100_000)])


def test_a_dense_cloud_all_around_is_a_lidars() -> None:
    assert SPINNING.is_lidar
    assert SPINNING.points == 100_000
    assert SPINNING.azimuth_share == 1.0
    assert np.rad2deg(SPINNING.elevation_span_rad) == pytest.approx(28 * 0.96, abs=0.5)


def test_a_lidar_thinned_to_a_thousand_points_is_still_one() -> None:
    assert lidar_properties([cloud(1000), cloud(0), cloud(1000)]).is_lidar


@pytest.mark.parametrize(
    ("of", "why_not"),
    [
        pytest.param(cloud(20_000, azimuth_deg=(-40, 40)), "sees only 80", id="depth camera"),
        pytest.param(cloud(60_000, azimuth_deg=(-60, 60)), "sees only 120", id="forward lidar"),
        pytest.param(cloud(500), "only 500 valid points", id="radars"),
        pytest.param(cloud(3000, extra="rcs"), "radar's", id="imaging radars"),
        pytest.param(cloud(4000, elevation_deg=(0, 0.5)), "0.5 degrees of el", id="plane"),
        pytest.param(cloud(90_000, frame_id="map"), "'map'", id="map"),
        pytest.param(cloud(90_000, frame_id="/odom"), "'/odom'", id="accumulated"),
        pytest.param(cloud(0), "no valid points", id="empty"),
    ],
)
def test_what_is_no_spinning_lidar_is_told_apart_with_a_reason(
    of: DecodedCloud, why_not: str
) -> None:
    evidence = lidar_properties([of])
    assert not evidence.is_lidar
    assert why_not in evidence.why_not
    assert choose_lidars({"/points": evidence}) == []


def test_clouds_without_positions_and_no_clouds_are_no_lidars() -> None:
    bare = DecodedCloud(1, "lidar", 2, 1, {"range": np.ones(2)}, b"")
    assert not lidar_properties([bare]).is_lidar
    assert not lidar_properties([]).is_lidar


def test_all_lidars_are_chosen_densest_first_whatever_order_they_come_in() -> None:
    candidates = {
        "/depth": lidar_properties([cloud(300_000, azimuth_deg=(-40, 40), frame_id="camera")]),
        "/rear": lidar_properties([cloud(30_000, frame_id="rear")]),
        "/top": lidar_properties([cloud(100_000, frame_id="top")]),
        "/left": lidar_properties([cloud(30_000, frame_id="left")]),
    }
    assert choose_lidars(candidates) == ["/top", "/left", "/rear"]
    assert choose_lidars(dict(reversed(candidates.items()))) == ["/top", "/left", "/rear"]


def test_a_filtered_copy_of_a_lidar_is_not_chosen_beside_it() -> None:
    candidates = {
        "/points_no_ground": lidar_properties([cloud(60_000, stamp_ns=5)]),
        "/points": lidar_properties([cloud(100_000, stamp_ns=5), cloud(100_000, stamp_ns=6)]),
    }
    assert choose_lidars(candidates) == ["/points"]


def test_two_lidars_that_share_a_space_are_both_chosen() -> None:
    candidates = {
        "/front": lidar_properties([cloud(100_000, stamp_ns=5, frame_id="base_link")]),
        "/rear": lidar_properties([cloud(90_000, stamp_ns=7, frame_id="base_link")]),
    }
    assert choose_lidars(candidates) == ["/front", "/rear"]


def test_the_lidar_is_chosen_rather_than_the_topic_with_its_labels() -> None:
    candidates = {
        "/labels": lidar_properties([cloud(100_000, extra="label")]),
        "/points": lidar_properties([cloud(100_000)]),
    }
    assert choose_lidars(candidates) == ["/points"]


@pytest.mark.reference
@pytest.mark.parametrize("damage", ["d00_control_undamaged", "d05_zero_length_cloud"])
def test_a_real_lidar_thinned_a_hundred_times_is_chosen(reference: Path, damage: str) -> None:
    where = Channel(
        topic="/lidar/top/points",
        message_encoding="cdr",
        schema_name="sensor_msgs/msg/PointCloud2",
        schema_encoding="ros2msg",
        schema_base64="",
        ids=((0, 1),),
    )
    with (reference / "data" / "mcap-zoo" / "damaged" / f"{damage}.mcap").open("rb") as file:
        clouds = [
            decode_cloud(RawMessage(where, message.log_time, message.data))
            for _, _, message in NonSeekingReader(file).iter_messages()
        ]
    assert choose_lidars({"/lidar/top/points": lidar_properties(clouds)}) == ["/lidar/top/points"]
