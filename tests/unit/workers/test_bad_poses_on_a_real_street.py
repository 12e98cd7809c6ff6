from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import Blindness, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import pose
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.odometry.odometry import KissOdometry
from workers.selfsupervised.stream import Registration

LOG = "pandaset/panda-01/2019-05-11/pandaset-002"
BAD, FRAMES = 10, 19
TRUE_STATIC = 1


def frames_of(reference: Path) -> Iterator[LidarFrame]:
    bucket_url = (reference / "data" / "logs").as_uri()
    settings = MiningSettings(bucket=bucket_url, artifacts="memory://")
    bucket = open_bucket(bucket_url)
    (recording,) = group_recordings(bucket.list(prefix=LOG.rpartition("/")[0]))
    shard = plan_recording(bucket, recording, settings).shards[0]
    yield from islice(read_shard(bucket, recording, shard, settings).frames(), FRAMES)


@pytest.fixture(scope="module")
def posed(reference: Path) -> list[PosedFrame]:
    return list(KissOdometry()(frames_of(reference)))


@pytest.mark.reference
@pytest.mark.parametrize("lasts", [1, FRAMES], ids=["once", "for good"])
@pytest.mark.parametrize(
    "error",
    [
        pytest.param(pose(0.5), id="half a metre along"),
        pytest.param(pose(0.0, 2.0), id="two metres aside"),
        pytest.param(pose(yaw_rad=np.radians(1.0)), id="a degree"),
    ],
)
def test_a_wrong_pose_in_a_real_street_gates_and_does_not_flood(
    reference: Path, posed: list[PosedFrame], error: np.ndarray, lasts: int
) -> None:
    """Unguarded, they make 6,000 to 300,000 false points; undisturbed frames up to 50 each."""
    disturbed = [
        replace(each, odom_from_sensor=each.odom_from_sensor @ error)
        if BAD <= i < BAD + lasts
        else each
        for i, each in enumerate(posed)
    ]
    false = 0
    blind = []
    for index, answer in enumerate(Registration()(disturbed)):
        truth = np.load(reference / "data" / "truth" / LOG / f"{index:06d}.npz")["motion"]
        if index >= BAD:
            false += int(((answer.labels == MotionLabel.DYNAMIC) & (truth == TRUE_STATIC)).sum())
            blind.append(answer.health.blindness)
    assert false < 300
    assert blind[0] is Blindness.NO_FIT
    # for good: the one that jumped, perhaps the next, which a bent sweep does not fit, and 0.4 s
    assert sum(each is not None for each in blind) in ([1] if lasts == 1 else [5, 6])
    assert blind[-1] is None
