"""The same frames give the same bytes, in any process and for any number of threads."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SAYS_ITS_LABELS = """
import hashlib, sys
from itertools import islice, tee
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from schemas.mining import MiningSettings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.odometry.odometry import KissOdometry
from workers.selfsupervised.stream import Registration

url, prefix = sys.argv[1:]
settings, bucket = MiningSettings(bucket=url, artifacts="memory://"), open_bucket(url)
(recording,) = group_recordings(bucket.list(prefix=prefix))
shard = plan_recording(bucket, recording, settings).shards[0]
frames = islice(read_shard(bucket, recording, shard, settings).frames(), 9)
posed, given = tee(KissOdometry()(frames))
digest, moving = hashlib.sha256(), 0
for each, said in zip(posed, Registration()(given), strict=True):
    moving += int((said.labels == 1).sum())
    for part in (each.odom_from_sensor, said.labels, said.confidence, said.cluster,
                 said.cluster_velocity_m_per_s, said.ground_mask, said.confirmed):
        digest.update(part.tobytes())
print(digest.hexdigest(), moving)
"""


@pytest.mark.integration
@pytest.mark.reference
def test_labels_are_the_same_bytes_for_any_number_of_threads(reference: Path) -> None:
    said = []
    for threads in ("1", "2", "4"):
        set_to = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), threads)
        run = subprocess.run(
            [
                *(sys.executable, "-c", SAYS_ITS_LABELS),
                (reference / "data" / "logs").as_uri(),
                "pandaset/panda-01/2019-05-11",
            ],
            env={**os.environ, **set_to, "PYTHONHASHSEED": threads},
            capture_output=True,
            text=True,
            check=True,
            timeout=240,
        )
        said.append(run.stdout.split())
    assert said[0] == said[1] == said[2]
    assert int(said[0][1]) > 1000
