"""Inspecting says what is in a log, from its index or from every chunk of it."""

from dataclasses import replace

import pytest

from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import recording_of
from tests.tiny_logs import BEGIN_NS, LIDAR, Recorder, Said, drive, only_recording, settings
from workers.errors import NotMcapError
from workers.ingest.inspect import LogReport, inspect_recording

RECORDER = Recorder(chunk_bytes=30_000)


def bucket_with(*parts: bytes) -> Bucket:
    bucket = open_bucket("memory://")
    for number, part in enumerate(parts):
        bucket.put(f"car-7/today/drive_{number}.mcap", part)
    return bucket


def inspected(*parts: bytes, verify: bool = False) -> LogReport:
    bucket = bucket_with(*parts)
    return inspect_recording(bucket, only_recording(bucket), settings(), verify=verify)


@pytest.mark.parametrize("verify", [False, True])
def test_a_whole_log_is_reported_alike_by_its_index_and_its_chunks(verify: bool) -> None:
    messages = [*drive(25), Said("/gps", BEGIN_NS + 10, b"1234")]
    report = inspected(RECORDER.write(messages), verify=verify)
    assert report.log_id == "car-7/today/drive"
    assert (report.vehicle, report.date) == ("car-7", "today")
    assert {topic.topic: topic.messages for topic in report.topics} == {"/gps": 1, LIDAR: 250}
    assert report.lidar_topic == LIDAR
    assert report.frames == 250
    assert report.start_ns == BEGIN_NS
    assert report.duration_s == pytest.approx(24.9, abs=0.1)
    assert [shard.name for shard in report.shards] == ["lidar.points-00000", "lidar.points-00001"]
    assert report.damage == ()
    assert report.refused == ""
    assert report.verified is verify


def test_only_verifying_finds_what_the_index_cannot_know() -> None:
    messages = drive(5)
    messages[20] = replace(messages[20], data=b"\x00\x01\x00\x00")
    data = bytearray(RECORDER.write(messages))
    victim = data.find(b"\x06", len(data) // 4)
    data[victim + 5000] ^= 255
    by_index = inspected(bytes(data))
    assert (by_index.frames, by_index.damage) == (50, ())
    verified = inspected(bytes(data), verify=True)
    assert verified.frames == 46
    assert len(verified.damage) == 2
    assert all(damage.key == "car-7/today/drive_0.mcap" for damage in verified.damage)
    assert all(damage.what for damage in verified.damage)


def test_any_part_reports_the_whole_recording() -> None:
    bucket = bucket_with(RECORDER.write(drive(3)), RECORDER.write(drive(2)))
    recording = recording_of("car-7/today/drive_1.mcap", bucket.list("car-7/today"))
    report = inspect_recording(bucket, recording, settings())
    assert report.parts == ("car-7/today/drive_0.mcap", "car-7/today/drive_1.mcap")
    assert report.frames == 50


def test_progress_is_told_until_all_bytes_are_done() -> None:
    bucket = bucket_with(RECORDER.write(drive(5)))
    told: list[tuple[int, int]] = []
    inspect_recording(
        bucket,
        only_recording(bucket),
        settings(),
        verify=True,
        progress=lambda done, total: told.append((done, total)),
    )
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1] > 0


def test_a_log_without_a_lidar_is_reported_with_the_reason() -> None:
    report = inspected(replace(RECORDER, schema_name="vendor/Scan").write(drive(1)), verify=True)
    assert (report.lidar_topic, report.frames, report.shards) == (None, 0, ())
    assert "no lidar" in report.refused
    assert report.topics[0].messages == 10


def test_messages_whose_channel_is_lost_are_damage() -> None:
    data = replace(RECORDER, chunk_bytes=10, repeat_channels=False, repeat_schemas=False).write(
        drive(3)
    )
    first = data.find(b"\x06")
    hurt = bytearray(data)
    hurt[first + 3000] ^= 255  # the one chunk that names the channel
    report = inspected(bytes(hurt), verify=True)
    problems = {damage.what for damage in report.damage}
    assert "1 messages of channels whose records are lost" in problems
    assert report.frames == 0


def test_what_is_no_log_is_an_error() -> None:
    with pytest.raises(NotMcapError):
        inspected(b"nothing of the kind")
