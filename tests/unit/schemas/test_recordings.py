"""Split recordings are one log; names that only look split are not."""

import pytest
import structlog.testing

from schemas.transport.bucket import ObjectMeta
from schemas.transport.recordings import group_recordings, recording_of


def objects(*keys: str) -> list[ObjectMeta]:
    return [ObjectMeta(key=key, size=10, etag=f'"{key}"') for key in keys]


def grouped(*keys: str) -> dict[str, list[str]]:
    return {
        recording.log_id: [part.key for part in recording.parts]
        for recording in group_recordings(objects(*keys))
    }


def test_a_log_that_no_message_could_name_is_left_out_and_the_others_are_listed() -> None:
    with structlog.testing.capture_logs() as said:
        for _ in range(2):
            assert list(grouped("a.mcap", "x" * 2000 + ".mcap", "b.mcap")) == ["a", "b"]
    assert [entry["event"] for entry in said] == [
        "log left out: its name or its parts are too long"
    ]


def test_every_mcap_file_is_a_log_and_nothing_else_is() -> None:
    assert grouped("car/day/b.mcap", "car/day/a.mcap", "car/metadata.yaml", "a.mcap.zst") == {
        "car/day/a": ["car/day/a.mcap"],
        "car/day/b": ["car/day/b.mcap"],
    }


def test_the_parts_of_a_split_recording_are_one_log_in_the_order_of_their_numbers() -> None:
    keys = [f"car/drive_{number}.mcap" for number in (10, 0, 2, 1)]
    assert grouped(*keys) == {"car/drive": [f"car/drive_{number}.mcap" for number in (0, 1, 2, 10)]}


@pytest.mark.parametrize(
    "keys",
    [
        pytest.param(("drive_1.mcap", "drive_2.mcap"), id="no part 0"),
        pytest.param(("drive_0.mcap", "drive.mcap"), id="the name is another log's"),
        pytest.param(("drive_2024.mcap", "drives_0/x.mcap"), id="a year"),
        pytest.param(("a/drive_0.mcap", "b/drive_1.mcap"), id="another folder"),
        pytest.param(("drive_00.mcap", "drive_01.mcap"), id="not how numbers are written"),
        pytest.param(("a/_0.mcap", "a/_1.mcap"), id="no name"),
    ],
)
def test_what_only_looks_split_is_logs_of_their_own(keys: tuple[str, ...]) -> None:
    by_log = {log_id: parts for log_id, parts in grouped(*keys).items() if len(parts) > 1}
    assert by_log == {}


def test_a_single_part_0_is_a_split_recording_of_one_part() -> None:
    assert grouped("drive_0.mcap") == {"drive": ["drive_0.mcap"]}


def test_a_recording_changes_its_revision_with_any_part() -> None:
    (before,) = group_recordings(objects("drive_0.mcap"))
    (after,) = group_recordings(objects("drive_0.mcap", "drive_1.mcap"))
    assert before.revision != after.revision


def test_any_part_leads_to_the_whole_recording() -> None:
    listed = objects("a/drive_0.mcap", "a/drive_1.mcap", "a/other.mcap")
    assert recording_of("a/drive_1.mcap", listed) == recording_of("a/drive_0.mcap", listed)
    assert len(recording_of("a/drive_1.mcap", listed).parts) == 2


def test_an_object_without_the_extension_can_still_be_named() -> None:
    assert recording_of("a/log.bin", objects("a/log.bin")).log_id == "a/log.bin"
    with pytest.raises(LookupError, match=r"no such object in the bucket: b\.mcap"):
        recording_of("b.mcap", objects("a.mcap"))
