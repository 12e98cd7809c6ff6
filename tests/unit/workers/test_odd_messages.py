"""One odd message, name or time costs itself, never the log, and never the process."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_NAME, MAX_SHARDS_OF_A_PLAN
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.work import Damage, LogPlan
from tests.tiny_logs import BEGIN_NS, LIDAR, only_recording, ring, settings
from tests.unit.workers.hostile_logs import Chunk, RawLog, chunk_of, message
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard

YEAR_NS = 365 * 86_400 * NS_PER_S
POINTS = "AAAgQQAAAAAAAAAAAAAAAA=="
"""One point of x = 10 m, in base64."""

GOOD = [BEGIN_NS + each * NS_PER_S // 10 for each in range(40)]


def plan_of(folder: Path, how: MiningSettings | None = None) -> LogPlan:
    bucket = open_bucket(str(folder))
    return plan_recording(bucket, only_recording(bucket), how or settings())


def frames_of(folder: Path, plan: LogPlan) -> tuple[list[int], list[Damage]]:
    """Return the stamps of all frames of a plan's shards, and the damage that reading found."""
    bucket = open_bucket(str(folder))
    stamps: list[int] = []
    damage: list[Damage] = []
    for shard in plan.shards:
        reader = read_shard(bucket, only_recording(bucket), shard, settings())
        stamps += [frame.stamp_ns for frame in reader.frames()]
        damage += reader.damage
    return stamps, damage


def clouds(times_ns: Sequence[int]) -> list[Chunk]:
    """Ten clouds in a chunk."""
    return [
        chunk_of((1, time_ns, ring(time_ns % 2**61)) for time_ns in times_ns[start : start + 10])
        for start in range(0, len(times_ns), 10)
    ]


@pytest.mark.parametrize("odd_ns", [2**62 + 1, 2**63 - 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize("place", [0, 15, 40])
@pytest.mark.parametrize("alone", [False, True], ids=["among others", "in a chunk of its own"])
@pytest.mark.parametrize("closed", [True, False], ids=["indexed", "cut off"])
def test_a_message_logged_at_no_possible_time_costs_itself(
    tmp_path: Path, odd_ns: int, place: int, alone: bool, closed: bool
) -> None:
    odd = (1, odd_ns, ring(GOOD[0]))
    if alone:
        chunks = clouds(GOOD)
        chunks.insert(place // 10, chunk_of([odd]))
    else:
        listed = [(1, time_ns, ring(time_ns)) for time_ns in GOOD]
        listed.insert(place, odd)
        chunks = [chunk_of(listed[:20]), chunk_of(listed[20:])]
    RawLog().write(tmp_path / "a.mcap", chunks, closed=closed)
    plan = plan_of(tmp_path)
    assert plan.refused == ""
    stamps, damage = frames_of(tmp_path, plan)
    assert stamps == GOOD
    assert any(str(odd_ns)[:6] in each.what for each in (*plan.damage, *damage))


@pytest.mark.parametrize("odd_ns", [0, 1, BEGIN_NS - 40 * YEAR_NS, BEGIN_NS + 50 * YEAR_NS, 2**62])
@pytest.mark.parametrize("place", [0, 4])
def test_a_message_of_another_century_costs_itself(tmp_path: Path, odd_ns: int, place: int) -> None:
    """Its window would be the millionth of the log."""
    chunks = clouds(GOOD)
    chunks.insert(place, chunk_of([(1, odd_ns, ring(odd_ns % 2**32))]))
    RawLog().write(tmp_path / "a.mcap", chunks)
    plan = plan_of(tmp_path)
    assert plan.refused == ""
    assert max(shard.index for shard in plan.shards) < MAX_SHARDS_OF_A_PLAN
    stamps, damage = frames_of(tmp_path, plan)
    assert set(stamps) >= set(GOOD)
    assert any("days from the rest" in each.what for each in plan.damage), damage


@pytest.mark.parametrize(
    ("topic", "says"),
    [
        pytest.param("", "has no name", id="empty"),
        pytest.param("///", "has no name", id="only slashes"),
        pytest.param("/" + "t" * 299, "a name of 300 characters", id="300 characters"),
        pytest.param("/li\x1bdar", "control characters", id="control character"),
        pytest.param("/li\x00dar", "control characters", id="NUL"),
    ],
)
def test_a_topic_that_no_message_may_name_is_not_mined(
    tmp_path: Path, topic: str, says: str
) -> None:
    chunks = clouds(GOOD)
    RawLog([topic]).write(tmp_path / "a.mcap", chunks)
    plan = plan_of(tmp_path)
    assert plan.refused
    assert says in plan.damage[0].what
    RawLog([LIDAR, topic]).write(tmp_path / "a.mcap", chunks)
    assert [shard.lidar.topic for shard in plan_of(tmp_path).shards] == [LIDAR]


def test_a_vehicle_with_a_name_of_thousands_of_characters_is_shortened(tmp_path: Path) -> None:
    metadata = {
        "counterpoint.log": {"vehicle": "v" * 5000, "date": "a\nb", "software_version": "1"}
    }
    RawLog(metadata=metadata).write(tmp_path / "a.mcap", clouds(GOOD))
    plan = plan_of(tmp_path)
    assert len(plan.vehicle) == MAX_NAME
    assert (plan.date, plan.software_version) == (r"a\nb", "1")
    assert plan.shards[0].vehicle == plan.vehicle
    assert [each.what.split(",")[0] for each in plan.damage] == [
        "the vehicle has 5000 characters",
        "the date has 3 characters",
    ]


def test_a_sentence_about_a_log_is_no_longer_than_a_sentence(tmp_path: Path) -> None:
    RawLog([f"/{'t' * 250}{each}" for each in range(100)]).write(tmp_path / "a.mcap", [])
    plan = plan_of(tmp_path)
    assert 0 < len(plan.refused) <= 4096


@pytest.mark.parametrize("sec", [2**31, 2**63, 2**64, 10**30, -(2**40), "1e400"])
def test_an_absurd_stamp_in_json_costs_its_message(tmp_path: Path, sec: int | str) -> None:
    def cloud(stamp: str) -> bytes:
        fields = [{"name": name, "offset": 4 * at, "type": 7} for at, name in enumerate("xyz")]
        body = {"frame_id": "lidar", "point_stride": 16, "fields": fields, "data": POINTS}
        return json.dumps(body)[:-1].encode() + f', "timestamp": {stamp}}}'.encode()

    good = [(1, at, cloud(f'{{"sec": {at // NS_PER_S}, "nsec": {at % NS_PER_S}}}')) for at in GOOD]
    odd = (1, GOOD[20] + 1000, cloud(f'{{"sec": {sec}, "nsec": 0}}'))
    RawLog(encoding="json", schema_name="foxglove.PointCloud").write(
        tmp_path / "a.mcap", [chunk_of(good[:21]), chunk_of([odd]), chunk_of(good[21:])]
    )
    plan = plan_of(tmp_path, MiningSettings(bucket="", artifacts="", lidar_topic=LIDAR))
    assert plan.refused == ""
    stamps, _ = frames_of(tmp_path, plan)
    assert set(stamps) >= set(GOOD)


def test_a_flood_of_messages_is_read_no_further_than_a_lidar_turns(tmp_path: Path) -> None:
    flood = b"".join(
        message(1, GOOD[20] + each, ring(GOOD[20] + each, points=1)) for each in range(20_000)
    )
    chunks = clouds(GOOD)
    chunks.insert(2, Chunk(flood, GOOD[20], GOOD[20] + 20_000, {1: 20_000}))
    RawLog().write(tmp_path / "a.mcap", chunks)
    plan = plan_of(tmp_path)
    stamps, damage = frames_of(tmp_path, plan)
    assert len(stamps) < 40 + 250
    assert set(stamps) >= set(GOOD[:20])
    assert len(damage) == 1000
    assert "more stretches cannot be read" in damage[-1].what


def test_a_cloud_of_more_points_than_any_lidar_gives_costs_itself(tmp_path: Path) -> None:
    chunks = clouds(GOOD)
    large = ring(GOOD[20] + 1000, points=2_100_000)
    chunks.insert(2, chunk_of([(1, GOOD[20] + 1000, large)]))
    RawLog().write(tmp_path / "a.mcap", chunks)
    stamps, damage = frames_of(tmp_path, plan_of(tmp_path))
    assert stamps == GOOD
    assert "2100000 points, more than 2000000" in damage[0].what
