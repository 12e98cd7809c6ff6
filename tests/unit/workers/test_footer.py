"""A recording listed a moment ago: planned at once when it is whole, waited for when it is not."""

import pytest

from schemas.transport.bucket import Bucket, open_bucket
from tests.tiny_logs import Recorder, drive, only_recording, settings
from workers.ingest import footer as footer_module
from workers.ingest.footer import StillGrowingError, TruncatedPart, is_closed
from workers.ingest.part_reader import PartReader
from workers.ingest.plan import plan_recording

WHOLE = Recorder().write(drive(4))


def bucket_with(*parts: bytes) -> Bucket:
    bucket = open_bucket("memory://")
    for number, part in enumerate(parts):
        bucket.put(f"drive_{number}.mcap", part)
    return bucket


def reader_of(data: bytes) -> PartReader:
    bucket = bucket_with(data)
    return PartReader(bucket, only_recording(bucket).parts[0], 0)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="nothing yet"),
        pytest.param(WHOLE[:8], id="only the first mark"),
        pytest.param(WHOLE[: len(WHOLE) // 2], id="half an upload"),
        pytest.param(WHOLE[:-1], id="a byte short"),
        pytest.param(WHOLE[:-8], id="without the last mark"),
        pytest.param(WHOLE[: len(WHOLE) // 2] + WHOLE[-8:], id="a mark, but no footer before it"),
        pytest.param(WHOLE[:-37] + bytes(29) + WHOLE[-8:], id="zeros for a footer"),
        pytest.param(bytes(8) + WHOLE[8:], id="the first bytes are still to come"),
        pytest.param(WHOLE + bytes(4096), id="grown to its size, not yet written"),
    ],
)
def test_what_is_not_closed_is_not_planned_before_it_has_settled(data: bytes) -> None:
    bucket = bucket_with(data)
    with pytest.raises(StillGrowingError, match=r"no valid footer yet \(drive_0\.mcap, "):
        plan_recording(bucket, only_recording(bucket), settings(), settled=False)


def test_a_whole_recording_is_planned_at_once_like_a_settled_one() -> None:
    bucket = bucket_with(WHOLE)
    recording = only_recording(bucket)
    at_once = plan_recording(bucket, recording, settings(), settled=False)
    assert at_once.shards
    assert at_once == plan_recording(bucket, recording, settings(), settled=True)


def test_one_part_that_still_grows_keeps_its_whole_recording_waiting() -> None:
    bucket = bucket_with(WHOLE, WHOLE[:-9])
    with pytest.raises(StillGrowingError, match=r"drive_1\.mcap"):
        plan_recording(bucket, only_recording(bucket), settings(), settled=False)


def test_the_look_at_the_footer_costs_two_small_reads_which_planning_shares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(footer_module, "TAIL_BYTES", 4096)
    reader = reader_of(WHOLE)
    assert is_closed(reader)
    assert reader.range_reads == 2
    assert reader.bytes_read == 4096 + 8
    bucket = bucket_with(WHOLE)
    recording = only_recording(bucket)
    settled = plan_recording(bucket, recording, settings(), settled=True)
    at_once = plan_recording(bucket, recording, settings(), settled=False)
    assert at_once.range_reads == settled.range_reads + 1


def test_an_upload_in_progress_is_found_out_in_one_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(footer_module, "TAIL_BYTES", 4096)
    reader = reader_of(WHOLE[: len(WHOLE) // 2])
    assert not is_closed(reader)
    assert reader.range_reads == 1


def test_a_settled_log_that_was_cut_off_is_planned_as_far_as_it_goes_and_said_so() -> None:
    cut = WHOLE[: len(WHOLE) * 6 // 10]
    bucket = bucket_with(cut)
    told: list[TruncatedPart] = []
    plan = plan_recording(
        bucket, only_recording(bucket), settings(), settled=True, on_truncated=told.append
    )
    assert plan.shards
    (part,) = told
    assert (part.key, part.size) == ("drive_0.mcap", len(cut))
    assert 1.0 < part.seconds < 3.5
    assert plan.truncated_parts == 1


def test_nothing_is_said_of_logs_that_were_closed_with_or_without_an_index() -> None:
    bucket = bucket_with(
        WHOLE, Recorder(repeat_channels=False, repeat_schemas=False).write(drive(4))
    )
    told: list[TruncatedPart] = []
    plan = plan_recording(bucket, only_recording(bucket), settings(), on_truncated=told.append)
    assert told == []
    assert plan.truncated_parts == 0
