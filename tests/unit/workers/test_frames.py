"""From clouds to frames: which time, which unit, which points are returns."""

from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, StampAt
from workers.errors import CloudUnreadableError
from workers.ingest.frames import frame_from_cloud, frame_stamp_ns, intensity_scale_of
from workers.ingest.pointcloud import DecodedCloud

STAMP_NS = 1_700_000_000 * NS_PER_S + 123_456_789
SWEEP_NS = np.array([0, 25_000_000, 50_000_000, 100_000_000])


def cloud(points: int = 4, *, stamp_ns: int = STAMP_NS, **fields: NDArray[Any]) -> DecodedCloud:
    axes = {name: np.arange(1, points + 1, dtype=np.float32) for name in "xyz"}
    return DecodedCloud(
        stamp_ns=stamp_ns,
        frame_id="lidar",
        points=points,
        height=1,
        fields=axes | fields,
        data=b"",
    )


def cloud_with(name: str, values: NDArray[Any]) -> DecodedCloud:
    fields: dict[str, Any] = {name: values}
    return cloud(**fields)


def frame(
    decoded: DecodedCloud,
    *,
    log_time_ns: int = STAMP_NS + 7,
    previous_stamp_ns: int | None = None,
    intensity_scale: float = 1.0,
    stamp_at: StampAt = "start",
) -> LidarFrame:
    return frame_from_cloud(
        decoded,
        log_id="log",
        log_time_ns=log_time_ns,
        previous_stamp_ns=previous_stamp_ns,
        intensity_scale=intensity_scale,
        stamp_at=stamp_at,
    )


@pytest.mark.parametrize(
    ("header_ns", "log_time_ns", "previous_ns", "expected_ns"),
    [
        pytest.param(100, 130, None, 100, id="the first header"),
        pytest.param(200, 230, 100, 200, id="a header that rises"),
        pytest.param(0, 130, None, 130, id="a header of zero"),
        pytest.param(0, 230, 130, 230, id="a header that stays zero"),
        pytest.param(100, 230, 100, 230, id="a header that repeats"),
        pytest.param(90, 230, 100, 230, id="a header that falls"),
        pytest.param(100, 100, 100, 100, id="a message recorded twice"),
        pytest.param(40, 50, 100, 50, id="time that jumps back"),
    ],
)
def test_a_frame_takes_the_headers_time_or_else_the_logs(
    header_ns: int, log_time_ns: int, previous_ns: int | None, expected_ns: int
) -> None:
    stamp_ns = frame_stamp_ns(header_ns, log_time_ns=log_time_ns, previous_stamp_ns=previous_ns)
    assert stamp_ns == expected_ns
    decoded = cloud(stamp_ns=header_ns)
    made = frame(decoded, log_time_ns=log_time_ns, previous_stamp_ns=previous_ns)
    assert made.stamp_ns == expected_ns


ABSOLUTE_S = (SWEEP_NS + STAMP_NS) / NS_PER_S


@pytest.mark.parametrize(
    ("name", "values"),
    [
        pytest.param("t", SWEEP_NS.astype(np.uint32), id="Ouster"),
        pytest.param("time", (SWEEP_NS / 1e9).astype(np.float32), id="Velodyne"),
        pytest.param("timestamp", ABSOLUTE_S, id="Hesai"),
        pytest.param("timestamp", (SWEEP_NS + STAMP_NS).astype(np.float64), id="Livox"),
        pytest.param("timestamp", (SWEEP_NS + STAMP_NS).astype(np.uint64), id="uint64"),
        pytest.param("offset_time", SWEEP_NS.astype(np.uint32), id="Livox, relative"),
        pytest.param("offset_ns", SWEEP_NS.astype(np.int32), id="Argoverse"),
        pytest.param("time_stamp", SWEEP_NS.astype(np.uint32), id="Nebula"),
        pytest.param("timestamp", SWEEP_NS.astype(np.float64), id="ns as floats"),
        pytest.param("time", (SWEEP_NS / 1e6).astype(np.float32), id="ms"),
        pytest.param("time", (SWEEP_NS // 1000).astype(np.uint32), id="us"),
        pytest.param("time_offset_us", (SWEEP_NS / 1e3).astype(np.float32), id="us by name"),
        pytest.param("timestamp", (SWEEP_NS + STAMP_NS) / 1e3, id="us since the epoch"),
        pytest.param("timestamp", (SWEEP_NS + STAMP_NS) / 1e6, id="ms since the epoch"),
        pytest.param("time_s", ABSOLUTE_S, id="s since the epoch, by name"),
        pytest.param("t", (SWEEP_NS / 1e9).astype(np.float64), id="s in float64"),
    ],
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_point_times_of_usual_names_and_units_become_offsets(
    name: str, values: NDArray[Any], order: Literal["<", ">"]
) -> None:
    made = frame(cloud_with(name, values.astype(values.dtype.newbyteorder(order))))
    assert made.has_point_time
    assert np.abs(made.offset_ns - SWEEP_NS).max() <= 2000


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.uint32])
def test_a_slow_sweep_in_ns_is_not_taken_for_seconds_since_the_epoch(dtype: type[Any]) -> None:
    slow_ns = np.linspace(0, 400_000_000, 50)
    made = frame(cloud(50, timestamp=slow_ns.astype(dtype)))
    assert np.abs(made.offset_ns - slow_ns).max() <= 20


def test_seconds_of_the_week_are_times_of_another_clock() -> None:
    made = frame(cloud(50, timestamp=345_600.25 + np.linspace(0, 0.1, 50)))
    assert made.has_point_time
    np.testing.assert_allclose(made.offset_ns, np.linspace(0, 1e8, 50), atol=100)


def test_points_before_a_stamp_at_the_end_of_the_sweep_have_negative_offsets() -> None:
    made = frame(cloud(time=np.array([-0.1, -0.05, -0.02, 0], dtype=np.float32)), stamp_at="end")
    np.testing.assert_allclose(made.offset_ns, [-100e6, -50e6, -20e6, 0], atol=10)
    assert made.stamp_at == "end"


@pytest.mark.parametrize(
    ("stamp_at", "shift_ns"), [("start", 0), ("middle", -50_000_000), ("end", -100_000_000)]
)
def test_times_of_another_clock_count_from_the_instant_that_the_stamp_names(
    stamp_at: StampAt, shift_ns: int
) -> None:
    other_clock = (SWEEP_NS + 1_300_000_000 * NS_PER_S).astype(np.uint64)
    made = frame(cloud(timestamp=other_clock), stamp_at=stamp_at)
    np.testing.assert_array_equal(made.offset_ns, SWEEP_NS + shift_ns)


@pytest.mark.parametrize(
    "values",
    [
        np.zeros(4, dtype=np.float32),
        np.full(4, 7, dtype=np.uint32),
        np.full(4, np.nan),
        np.float32(STAMP_NS / 1e9) + np.linspace(0, 200, 50, dtype=np.float32),
    ],
    ids=["zero", "one value", "NaN", "seconds since the epoch in float32"],
)
def test_times_that_do_not_tell_the_points_apart_are_none(values: NDArray[Any]) -> None:
    assert not frame(cloud(len(values), time=values)).has_point_time


def test_a_time_outside_the_sweep_is_zero_and_spoils_no_other() -> None:
    times = SWEEP_NS.astype(np.uint32)
    times[2] = 0xFFFFFFFF
    np.testing.assert_array_equal(frame(cloud(t=times)).offset_ns, SWEEP_NS * [1, 1, 0, 1])


def test_a_fragment_of_a_sweep_keeps_the_unit_of_its_driver() -> None:
    made = frame(cloud(t=np.array([0, 100, 5000, 9000], dtype=np.uint32)))
    np.testing.assert_array_equal(made.offset_ns, [0, 100, 5000, 9000])


def test_invalid_points_are_masked_and_zero_but_never_dropped() -> None:
    x = np.array([1, np.nan, np.inf, 0, 3e38, 1e-40, 7], dtype=np.float32)
    zeros = np.zeros(7, dtype=np.float32)
    made = frame(cloud(7, x=x, y=zeros, z=zeros))
    assert made.valid_mask.tolist() == [True, False, False, False, False, True, True]
    np.testing.assert_array_equal(made.points_m[:, 0], [1, 0, 0, 0, 0, np.float32(1e-40), 7])
    assert len(made) == 7


def test_float64_positions_that_no_float32_can_hold_are_masked() -> None:
    made = frame(cloud(2, x=np.array([1e300, 2.5]), y=np.ones(2), z=np.ones(2)))
    assert made.valid_mask.tolist() == [False, True]
    np.testing.assert_array_equal(made.points_m[1], [2.5, 1, 1])


@pytest.mark.parametrize("name", ["intensity", "i", "reflectivity", "remission", "signal"])
def test_intensity_is_divided_by_its_scale_and_clipped(name: str) -> None:
    values = np.array([0, 51, 255, 300], dtype=np.float32)
    made = frame(cloud_with(name, values), intensity_scale=255)
    np.testing.assert_allclose(made.intensity, [0, 0.2, 1, 1])


def test_intensity_that_is_no_number_is_zero() -> None:
    made = frame(cloud(intensity=np.array([np.nan, np.inf, -np.inf, -3], dtype=np.float32)))
    np.testing.assert_array_equal(made.intensity, [0, 1, 0, 0])


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        pytest.param(np.array([0.0, 0.4, 0.99]), 1, id="normalised"),
        pytest.param(np.array([0.0, 1.2, np.nan]), 1, id="normalised, a little over"),
        pytest.param(np.array([0.0, 40, 255]), 255, id="bytes in floats"),
        pytest.param(np.array([0, 1, 1], dtype=np.uint8), 255, id="dark bytes"),
        pytest.param(np.array([0, 1, 200], dtype=np.uint16), 255, id="bytes in words"),
        pytest.param(np.array([0, 900, 3000], dtype=np.uint16), 4095, id="12 bits"),
        pytest.param(np.array([0, 900, 60000], dtype=np.uint16), 65535, id="16 bits"),
        pytest.param(np.array([0, 1e9, 1e9]), 65535, id="beyond all"),
        pytest.param(np.array([], dtype=np.float32), 1, id="empty"),
    ],
)
def test_the_scale_of_intensity_is_judged_by_type_and_values(
    values: NDArray[Any], scale: float
) -> None:
    assert intensity_scale_of([cloud(len(values), intensity=values)]) == scale


def test_without_intensity_the_scale_is_one() -> None:
    assert intensity_scale_of([cloud(), cloud(0)]) == 1
    assert intensity_scale_of([]) == 1


def test_one_saturated_return_does_not_change_the_scale() -> None:
    values = np.full(1000, 0.5, dtype=np.float32)
    values[3] = 4000
    assert intensity_scale_of([cloud(1000, intensity=values)]) == 1


@pytest.mark.parametrize("name", ["ring", "laser_number", "channel", "line"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32])
def test_rings_of_usual_names_and_types_are_kept(name: str, dtype: type[Any]) -> None:
    made = frame(cloud_with(name, np.array([0, 1, 63, 127], dtype=dtype)))
    assert made.ring.tolist() == [0, 1, 63, 127]


def test_a_ring_that_is_none_is_minus_one() -> None:
    assert frame(cloud()).ring.tolist() == [-1] * 4
    odd = frame(cloud(ring=np.array([5, -7, np.nan, 1e6], dtype=np.float32)))
    assert odd.ring.tolist() == [5, -1, -1, -1]
    assert frame(cloud(1, ring=np.array([65535], dtype=np.uint16))).ring.tolist() == [-1]


def test_an_empty_cloud_makes_an_empty_frame() -> None:
    made = frame(cloud(0, t=np.empty(0, dtype=np.uint32), intensity=np.empty(0)))
    assert len(made) == 0
    assert not made.has_point_time
    assert len(frame(DecodedCloud(STAMP_NS, "lidar", 0, 1, {}, b""))) == 0


@pytest.mark.parametrize("points", [1, 300_000])
def test_one_point_and_300_000_points_make_frames(points: int) -> None:
    times = np.linspace(0, 0.1, points, dtype=np.float32)
    made = frame(cloud(points, time=times, ring=np.zeros(points, dtype=np.uint16)))
    assert len(made) == points
    assert made.has_point_time is (points > 1)


def test_a_cloud_without_positions_is_refused() -> None:
    bare = DecodedCloud(STAMP_NS, "lidar", 1, 1, {"x": np.ones(1), "range": np.ones(1)}, b"")
    with pytest.raises(CloudUnreadableError, match="no field y, z; fields are range, x"):
        frame(bare)


def test_any_bytes_make_a_frame_of_finite_numbers() -> None:
    rng = np.random.default_rng(3)
    names = ("x", "y", "z", "time", "intensity", "ring")
    for kind in ("f4", "f8", "u1", "i2", "u4", "i8", ">f4", ">f8"):
        for _ in range(40):
            raw = rng.integers(0, 256, size=(6, 200), dtype=np.uint8)
            fields: dict[str, Any] = {
                name: np.frombuffer(row.tobytes(), dtype=kind)[:25]
                for name, row in zip(names, raw, strict=True)
            }
            made = frame(cloud(25, **fields), intensity_scale=255)
            assert np.isfinite(made.points_m).all()
            assert ((made.intensity >= 0) & (made.intensity <= 1)).all()
            assert (made.ring >= -1).all()
            assert not made.points_m[~made.valid_mask].any()
