from collections.abc import Iterator
from itertools import islice, tee
from pathlib import Path

import numpy as np
import pytest

from schemas.frame import LidarFrame, OdometryState
from schemas.labels import MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.odometry.odometry import KissOdometry
from workers.selfsupervised.stream import Registration

TRUE_STATIC, TRUE_DYNAMIC = 1, 2
WARM_UP = 10


def frames_of(reference: Path, log: str, count: int) -> Iterator[LidarFrame]:
    bucket_url = (reference / "data" / "logs").as_uri()
    settings = MiningSettings(bucket=bucket_url, artifacts="memory://")
    bucket = open_bucket(bucket_url)
    recordings = group_recordings(bucket.list(prefix=log.rpartition("/")[0]))
    (recording,) = (found for found in recordings if found.log_id == log)
    shard = plan_recording(bucket, recording, settings).shards[0]
    yield from islice(read_shard(bucket, recording, shard, settings).frames(), count)


@pytest.mark.reference
def test_what_moves_in_a_real_street_is_found_point_by_point(reference: Path) -> None:
    """The whole scene gives .972 over frames 10 to 55; 0.90 is what must never be undercut."""
    log = "pandaset/panda-01/2019-05-11/pandaset-002"
    frames, posed_from = tee(frames_of(reference, log, WARM_UP + 15))
    hit = false = missed = 0
    for index, (frame, answer) in enumerate(
        zip(frames, Registration()(KissOdometry()(posed_from)), strict=True)
    ):
        if index < WARM_UP:
            continue
        truth = np.load(reference / "data" / "truth" / log / f"{index:06d}.npz")["motion"]
        near = np.hypot(frame.points_m[:, 0], frame.points_m[:, 1]) < 50.0
        said = near & (answer.labels == MotionLabel.DYNAMIC)
        hit += int((said & (truth == TRUE_DYNAMIC)).sum())
        false += int((said & (truth == TRUE_STATIC)).sum())
        missed += int((near & ~said & (truth == TRUE_DYNAMIC)).sum())
    assert hit / (hit + false + missed) > 0.90
    assert hit / (hit + false) > 0.97


@pytest.mark.reference
@pytest.mark.parametrize(
    "log",
    [
        pytest.param("kitti/annieway-kitti/2011-09-26/kitti-raw-standing-1430", id="standing"),
        pytest.param("kitti/annieway-kitti/2011-10-03/kitti-odometry-00", id="without rings"),
    ],
)
def test_next_to_nothing_moves_where_next_to_nothing_moves(reference: Path, log: str) -> None:
    posed = list(KissOdometry()(frames_of(reference, log, 16)))
    assert all(each.odometry is OdometryState.HEALTHY for each in posed)
    for answer in Registration()(posed):
        assert (answer.labels == MotionLabel.DYNAMIC).mean() < 0.01
