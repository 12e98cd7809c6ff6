import json
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import SMALL_LIDAR, street_log
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.simulation.faults.fault_truth import PlantedFaults
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind, plan_fleet
from workers.lab.simulation.faults.recorded import record
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.output.cloud import cloud_of
from workers.lab.simulation.output.fixes import FIX_TOPIC, origin_of
from workers.lab.simulation.output.fleet import VEHICLES, on_days
from workers.lab.simulation.output.odometry import ODOMETRY_TOPIC, RATE_HZ
from workers.lab.simulation.output.write import LABEL_TOPIC, LIDAR_TOPIC, RecordedAs, write_log
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street

FRAMES = 12
KEY = "car-7/2026-03-02/drive"


def read_by_library(path: Path) -> tuple[dict[str, list[Any]], dict[str, dict[str, str]]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        messages: dict[str, list[Any]] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append((message, decoded))
        return messages, {each.name: each.metadata for each in reader.iter_metadata()}


def rows_of(decoded: Any) -> NDArray[Any]:
    kinds = {2: "<u1", 4: "<u2", 6: "<u4", 7: "<f4"}
    layout = np.dtype(
        {
            "names": [each.name for each in decoded.fields],
            "formats": [kinds[each.datatype] for each in decoded.fields],
            "offsets": [each.offset for each in decoded.fields],
            "itemsize": decoded.point_step,
        }
    )
    return np.frombuffer(bytes(decoded.data), layout)


def read_by_ingest(bucket_folder: Path) -> list[LidarFrame]:
    bucket = open_bucket(str(bucket_folder))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised="recorded")
    plan = plan_recording(bucket, recording, settings)
    assert not plan.refused
    assert not plan.damage
    (shard,) = plan.shards
    return list(read_shard(bucket, recording, shard, settings).frames())


def test_a_log_is_what_the_lidar_saw_and_any_reader_reads_it(tmp_path: Path) -> None:
    path = street_log(tmp_path / f"{KEY}.mcap", frames=FRAMES, recorded_as="nothing")
    messages, metadata = read_by_library(path)
    assert list(messages) == [LIDAR_TOPIC]
    assert len(messages[LIDAR_TOPIC]) == FRAMES
    street = build_street(1, seconds=FRAMES * SMALL_LIDAR.period_s, style="drives")
    for index, (message, decoded) in enumerate(messages[LIDAR_TOPIC]):
        stamp_ns = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
        assert stamp_ns == message.log_time
        seen = sweep(street, SMALL_LIDAR, index)
        assert rows_of(decoded).tobytes() == cloud_of(seen, None).tobytes()
    assert metadata == {
        "counterpoint.log": {
            "vehicle": "sim-01",
            "date": "2026-03-02",
            "software_version": "2026.1",
        }
    }
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_a_log_has_a_summary_and_chunks_that_its_index_finds(tmp_path: Path) -> None:
    path = street_log(tmp_path / "drive.mcap", frames=FRAMES, chunk_bytes=100_000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == FRAMES
    assert len(summary.chunk_indexes) > 2
    assert {each.compression for each in summary.chunk_indexes} == {"zstd"}


@pytest.mark.parametrize("recorded_as", ["fields", "topic"])
def test_labels_read_equal_labels_written(tmp_path: Path, recorded_as: RecordedAs) -> None:
    street = build_street(4, seconds=2.0, style="drives")
    planted = PlantedFaults((PlantedFailure(FailureKind.MISSED_MOVER, 0, 0.3, 0.9),))
    write_log(
        tmp_path / f"{KEY}.mcap", street, lidar=SMALL_LIDAR, recorded=recorded_as, planted=planted
    )
    frames = read_by_ingest(tmp_path)
    assert len(frames) == 20
    for index, frame in enumerate(frames):
        seen = sweep(street, SMALL_LIDAR, index)
        said = record(street, seen, planted.failures)
        assert frame.recorded is not None
        assert frame.recorded.motion is not None
        assert frame.recorded.confidence is not None
        np.testing.assert_array_equal(frame.points_m, seen.points_m)
        np.testing.assert_array_equal(frame.offset_ns, seen.offset_ns)
        np.testing.assert_array_equal(frame.ring, seen.ring)
        np.testing.assert_array_equal(frame.recorded.class_id, said.label)
        np.testing.assert_array_equal(frame.recorded.motion, said.motion)
        np.testing.assert_array_equal(frame.recorded.confidence, said.confidence)
        assert frame.recorded.classes[StreetClass.CAR].name == "car"
        assert frame.recorded.classes[StreetClass.CAR].movable
        assert not frame.recorded.classes[StreetClass.ROAD].movable


def test_labels_of_a_topic_of_their_own_have_the_stamp_and_width_of_the_cloud(
    tmp_path: Path,
) -> None:
    path = street_log(tmp_path / "drive.mcap", frames=3, recorded_as="topic")
    messages, _ = read_by_library(path)
    for (_, cloud), (_, labels) in zip(messages[LIDAR_TOPIC], messages[LABEL_TOPIC], strict=True):
        assert labels.header.stamp == cloud.header.stamp
        assert labels.width == cloud.width


def test_truth_lies_beside_the_log_message_by_message(tmp_path: Path) -> None:
    truth = tmp_path / "truth" / KEY
    path = street_log(tmp_path / "logs" / f"{KEY}.mcap", frames=FRAMES, truth=truth)
    messages, _ = read_by_library(path)
    listed = json.loads((truth / "frames.json").read_text())["frames"]
    poses = np.load(truth / "poses.npz")
    street = build_street(1, seconds=FRAMES * SMALL_LIDAR.period_s, style="drives")
    assert len(listed) == FRAMES == len(poses["stamp_ns"])
    for index, (row, (message, decoded)) in enumerate(
        zip(listed, messages[LIDAR_TOPIC], strict=True)
    ):
        arrays = np.load(truth / f"{index:06d}.npz")
        seen = sweep(street, SMALL_LIDAR, index)
        assert row["index"] == index
        assert row["header_stamp"] == message.log_time == poses["stamp_ns"][index]
        assert row["points"] == decoded.width == len(arrays["motion"])
        assert row["data_crc32"] == zlib.crc32(bytes(decoded.data))
        for name in ("motion", "track", "ground"):
            np.testing.assert_array_equal(arrays[name], getattr(seen, name))
        np.testing.assert_array_equal(arrays["semantic"], seen.class_id)


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    one, again = (
        street_log(tmp_path / f"{n}" / "drive.mcap", frames=5, truth=tmp_path / f"{n}" / "truth")
        for n in range(2)
    )
    assert one.read_bytes() == again.read_bytes()
    truths = [sorted((tmp_path / f"{n}" / "truth").iterdir()) for n in range(2)]
    assert [each.name for each in truths[0]] == [each.name for each in truths[1]]
    for mine, theirs in zip(*truths, strict=True):
        assert mine.read_bytes() == theirs.read_bytes(), mine.name


def test_a_log_may_be_written_to_memory() -> None:
    stream = BytesIO()
    street = build_street(1, seconds=1.0, style="stands")
    written = write_log(stream, street, lidar=SMALL_LIDAR, frames=2)
    assert written == 2
    assert stream.getvalue().startswith(b"\x89MCAP")


def test_a_car_that_records_its_motion_says_how_it_drove(tmp_path: Path) -> None:
    silent = street_log(tmp_path / "silent" / f"{KEY}.mcap", frames=FRAMES)
    path = street_log(tmp_path / "said" / f"{KEY}.mcap", frames=FRAMES, odometry=True)
    messages, _ = read_by_library(path)
    without, _ = read_by_library(silent)
    assert list(without) == [LIDAR_TOPIC]
    assert [each.data for each, _ in messages[LIDAR_TOPIC]] == [
        each.data for each, _ in without[LIDAR_TOPIC]
    ]
    assert len(messages[ODOMETRY_TOPIC]) == RATE_HZ * FRAMES // 10 + 1
    street = build_street(1, seconds=FRAMES * SMALL_LIDAR.period_s, style="drives")
    frames = read_by_ingest(tmp_path / "said")
    assert frames[0].moved is None
    for number, frame in enumerate(frames[1:-1], start=1):
        middle_s = (number + 0.5) * SMALL_LIDAR.period_s
        one, other = street.ego.pose(np.array([middle_s - SMALL_LIDAR.period_s, middle_s]))
        true = float(np.hypot(*(other - one)[:2])) / SMALL_LIDAR.period_s
        assert frame.moved is not None
        assert frame.moved.speed_m_per_s == pytest.approx(true, rel=0.08, abs=0.05)
        assert frame.moved.turn_rad_per_s < 0.1


def test_a_car_that_records_its_place_says_where_it_is(tmp_path: Path) -> None:
    plain = street_log(tmp_path / "plain" / f"{KEY}.mcap", frames=FRAMES)
    path = street_log(tmp_path / "placed" / f"{KEY}.mcap", frames=FRAMES, fixes=True)
    messages, without = (read_by_library(each)[0] for each in (path, plain))
    assert [each.data for each, _ in messages[LIDAR_TOPIC]] == [
        each.data for each, _ in without[LIDAR_TOPIC]
    ]
    street = build_street(1, seconds=FRAMES * SMALL_LIDAR.period_s, style="drives")
    south, west = origin_of(street)
    frames = read_by_ingest(tmp_path / "placed")
    fixes = [fix for frame in frames for fix in frame.fixes]
    assert len(fixes) >= FRAMES // 2
    off_m = []
    for fix in fixes:
        (at,) = street.ego.pose(np.array([(fix.time_ns - frames[0].stamp_ns) / 1e9]))
        east_m = (fix.at[1] - west) * 111_320.0 * np.cos(np.radians(south))
        off_m.append((east_m - at[0], (fix.at[0] - south) * 111_320.0 - at[1]))
    assert np.abs(np.mean(off_m, axis=0)).max() < 3.5
    assert np.std(off_m, axis=0).max() < 0.9
    again = street_log(tmp_path / "b" / f"{KEY}.mcap", frames=FRAMES, fixes=True, date="2026-03-09")
    assert read_by_library(again)[0][FIX_TOPIC] != messages[FIX_TOPIC], "each day has its error"


@pytest.mark.parametrize("logs", [1, 2, 5, 7])
def test_a_street_is_driven_again_on_another_day_by_another_car(logs: int) -> None:
    plans = plan_fleet(scenes=10 * logs, seed=3, share=0.2)
    drives = on_days(plans, 3)
    assert [each.seed for each in drives] == [plan.seed for plan in plans] * 3
    numbers = [each.number for each in drives]
    assert len(set(numbers)) == 3 * logs
    for first, again in zip(numbers[:logs], numbers[logs : 2 * logs], strict=True):
        assert first % len(VEHICLES) != again % len(VEHICLES)
        assert first // len(VEHICLES) < again // len(VEHICLES)
