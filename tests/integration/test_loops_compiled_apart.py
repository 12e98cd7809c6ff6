"""The first run on a machine holds no more memory than any other."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LABEL = """
import gc, sys
from collections import deque
from itertools import islice
from numba.core.dispatcher import Dispatcher
from schemas.bucket import open_bucket
from schemas.recordings import group_recordings
from schemas.mining import MiningSettings
from workers.evaluation.whole_log import shards_of_log
from workers.ingest.read import read_shard
from workers.registry import build_parts

parts = build_parts(odometry="kiss-icp", supervised="recorded", selfsupervised="registration")
settings = MiningSettings(bucket=sys.argv[1], artifacts="memory://")
bucket = open_bucket(settings.bucket)
(recording,) = group_recordings(bucket.list(prefix="pandaset/"))
(shard,) = shards_of_log(bucket, recording, settings)
frames = islice(read_shard(bucket, recording, shard, settings).frames(), 14)
labels = list(parts.selfsupervised(parts.odometry(frames)))
assert labels[-1].confirmed.any()
for each in gc.get_objects():
    if isinstance(each, Dispatcher) and each.stats.cache_path and each.stats.cache_misses:
        print("compiled here:", each.py_func.__qualname__)
"""


@pytest.mark.integration
@pytest.mark.reference
@pytest.mark.timeout(1800)
def test_the_first_process_that_labels_finds_every_loop_compiled(
    reference: Path, tmp_path: Path
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", LABEL, (reference / "data" / "logs").as_uri()],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    assert "compiling loops" in ended.stdout + ended.stderr
    assert "compiled here" not in ended.stdout
    assert list(tmp_path.rglob("*.compiled"))
