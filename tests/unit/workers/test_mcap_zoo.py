"""Every file of the zoo of odd, wild and damaged logs does what its manifest says."""

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.work import Part, Recording
from workers.errors import NotMcapError
from workers.ingest.inspect import LogReport, inspect_recording
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard

pytestmark = pytest.mark.reference

MAX_MEMORY_BYTES = 500_000_000
TOPICS_IN_MANIFEST = 12
"""It lists no more of them."""

INSPECT_ALL = """
import sys
from schemas.transport.bucket import open_bucket
from schemas.errors import PermanentError
from schemas.work import Part, Recording
from schemas.mining import MiningSettings
from workers.ingest.inspect import inspect_recording
from workers.memory import peak_memory_bytes

bucket = open_bucket(sys.argv[1])
settings = MiningSettings(bucket=bucket.url, artifacts="memory://")
seen = 0
for found in bucket.list():
    if not found.key.endswith(".json"):
        part = Part(key=found.key, size=found.size, etag=found.etag)
        recording = Recording(log_id=found.key, parts=(part,))
        seen += 1
        try:
            inspect_recording(bucket, recording, settings, verify=True)
        except PermanentError:
            pass
sys.stdout.write(f"{seen} {peak_memory_bytes()}")
"""
"""Run alone, so that the peak is that of the files and not of other tests."""


class Zoo:
    """The folder, its manifest, and what it takes to look at one file."""

    def __init__(self, folder: Path) -> None:
        manifest = json.loads((folder / "manifest.json").read_text())
        self.files: list[dict[str, Any]] = manifest["files"]
        self.bucket: Bucket = open_bucket(str(folder))
        self.settings = MiningSettings(bucket=self.bucket.url, artifacts="memory://")
        self._objects = {found.key: found for found in self.bucket.list()}

    def recording(self, key: str) -> Recording:
        found = self._objects[key]
        part = Part(key=key, size=found.size, etag=found.etag)
        return Recording(log_id=key.removesuffix(".mcap"), parts=(part,))

    def inspect(self, key: str) -> LogReport:
        return inspect_recording(self.bucket, self.recording(key), self.settings, verify=True)

    def of(self, folder: str) -> list[dict[str, Any]]:
        return [entry for entry in self.files if entry["file"].startswith(folder)]


@pytest.fixture(scope="module")
def zoo(reference: Path) -> Zoo:
    return Zoo(reference / "data" / "mcap-zoo")


def topics_found(report: LogReport) -> Counter[tuple[str, str, str]]:
    found: Counter[tuple[str, str, str]] = Counter()
    for topic in report.topics:
        found[topic.topic, topic.message_encoding, topic.schema_name] += topic.messages or 0
    return +found


def topics_expected(entry: dict[str, Any]) -> Counter[tuple[str, str, str]]:
    return +Counter(
        {
            (topic["topic"], topic["message_encoding"], topic["schema"] or ""): topic["messages"]
            for topic in entry["topics"]
        }
    )


def test_the_zoo_is_whole(zoo: Zoo) -> None:
    assert len(zoo.files) == 660
    assert [len(zoo.of(kind)) for kind in ("conformance", "wild", "damaged")] == [599, 47, 14]


@pytest.mark.parametrize("kind", ["conformance", "wild"])
def test_every_message_of_every_undamaged_file_is_counted(zoo: Zoo, kind: str) -> None:
    refused = []
    for entry in zoo.of(kind):
        if not entry["readable_by_streaming_reader"]:
            refused.append(entry["file"])
            with pytest.raises(NotMcapError, match=re.escape(f"/{entry['file']})")):
                zoo.inspect(entry["file"])
            continue
        report = zoo.inspect(entry["file"])
        assert report.damage == (), entry["file"]
        found, expected = topics_found(report), topics_expected(entry)
        assert sum(found.values()) == entry["message_count"], entry["file"]
        assert expected <= found, entry["file"]
        if len(entry["topics"]) < TOPICS_IN_MANIFEST:
            assert found == expected, entry["file"]
    # Two compressed as a whole, one of an early version of the format.
    assert len(refused) == (3 if kind == "wild" else 0)


def test_the_only_lidar_of_the_wild_is_found(zoo: Zoo) -> None:
    key = next(entry["file"] for entry in zoo.of("wild") if "pointcloudset" in entry["file"])
    report = zoo.inspect(key)
    assert (report.lidar_topic, report.frames) == ("/os1_cloud_node/points", 2)


def test_every_damaged_file_gives_all_its_good_clouds_and_says_what_is_lost(zoo: Zoo) -> None:
    for entry in zoo.of("damaged"):
        report, expected = zoo.inspect(entry["file"]), entry["expected"]
        well_formed = expected.get("clouds_well_formed", expected["clouds"])
        assert report.frames == well_formed, entry["file"]
        lost = entry["file"].split("/")[1][:3] in ("d01", "d02", "d03", "d04", "d07", "d08")
        assert bool(report.damage) == lost, entry["file"]
        assert all(damage.what for damage in report.damage)


def test_no_file_of_the_zoo_takes_much_memory(reference: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", INSPECT_ALL, str(reference / "data" / "mcap-zoo")],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    seen, peak_bytes = map(int, run.stdout.split())
    assert seen == 660
    assert peak_bytes < MAX_MEMORY_BYTES


def test_mining_reads_the_frames_that_verifying_counts(zoo: Zoo) -> None:
    for entry in zoo.of("damaged"):
        recording = zoo.recording(entry["file"])
        plan = plan_recording(zoo.bucket, recording, zoo.settings)
        points = [
            len(frame)
            for shard in plan.shards
            for frame in read_shard(zoo.bucket, recording, shard, zoo.settings).frames()
        ]
        expected = entry["expected"]
        assert len(points) == expected.get("clouds_well_formed", expected["clouds"])
        if "points_per_cloud" in expected:
            assert points == expected["points_per_cloud"]


def test_frames_come_in_time_order_out_of_a_file_that_is_not(zoo: Zoo) -> None:
    recording = zoo.recording("damaged/d09_out_of_order_timestamps.mcap")
    (shard,) = plan_recording(zoo.bucket, recording, zoo.settings).shards
    frames = read_shard(zoo.bucket, recording, shard, zoo.settings).frames()
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == sorted(stamps)
    assert len(set(stamps)) == 10


def test_an_encoding_of_a_vendor_is_named_with_what_would_be_needed(zoo: Zoo) -> None:
    report = zoo.inspect("damaged/d11_unknown_encoding.mcap")
    (topic,) = report.topics
    assert (topic.topic, topic.messages) == ("/lidar/top/points", 6)
    assert "x-vendor-lidar" in topic.needs
    assert "/lidar/top/points" in report.refused
