"""The real logs: six recordings of five encodings, each frame of them, in few reads."""

import json
from pathlib import Path

import pytest

from schemas.mining import Grid, MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard

pytestmark = pytest.mark.reference

LOGS = (
    "av2/av2-pit/1980-01-06/av2-7fab2350-pair",
    "kitti/annieway-kitti/2011-09-26/kitti-raw-standing-1430",
    "kitti/annieway-kitti/2011-09-26/kitti-raw-town",
    "kitti/annieway-kitti/2011-10-03/kitti-odometry-00",
    "kitti360/annieway-360/2013-05-28/kitti360-3000",
    "pandaset/panda-01/2019-05-11/pandaset-002",
)


def test_the_bucket_holds_six_recordings_in_eight_files(reference: Path) -> None:
    recordings = group_recordings(open_bucket(str(reference / "data" / "logs")).list())
    assert tuple(recording.log_id for recording in recordings) == LOGS
    assert sum(len(recording.parts) for recording in recordings) == 8


@pytest.mark.parametrize("shard_s", [20.0, 2.0])
@pytest.mark.parametrize("log_id", LOGS)
def test_every_frame_is_read_once_and_in_order(
    reference: Path, log_id: str, shard_s: float
) -> None:
    bucket = open_bucket(str(reference / "data" / "logs"))
    recordings = {each.log_id: each for each in group_recordings(bucket.list())}
    recording = recordings[log_id]
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", grid=Grid(shard_s=shard_s))
    plan = plan_recording(bucket, recording, settings)
    assert plan.refused == ""
    assert plan.damage == ()
    assert (plan.vehicle, plan.date) == tuple(log_id.split("/")[1:3])
    # One read for each part's index, and one chunk.
    assert plan.range_reads == len(recording.parts) + 1
    stamps, points = [], []
    for shard in plan.shards:
        reader = read_shard(bucket, recording, shard, settings)
        for frame in reader.frames():
            if shard.start_ns <= frame.stamp_ns < shard.end_ns:  # neither warm-up nor lookahead
                stamps.append(frame.stamp_ns)
                points.append(len(frame))
        assert reader.damage == []
    assert stamps == sorted(set(stamps))
    assert points == points_by_truth(reference, log_id)


def points_by_truth(reference: Path, log_id: str) -> list[int]:
    """Points of each cloud of a log, over all its parts."""
    folder = reference / "data" / "truth"
    parts = sorted({*folder.glob(log_id), *folder.glob(f"{log_id}_[0-9]*")})
    assert parts
    return [
        frame["points"]
        for part in parts
        for frame in json.loads((part / "frames.json").read_text())["frames"]
    ]
