"""The first run on a machine holds no more memory than any other."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MINE = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from schemas.mining import MiningSettings
from workers.score import score_recording

settings = MiningSettings(bucket=sys.argv[1], artifacts="memory://")
bucket = open_bucket(settings.bucket)
(recording,) = group_recordings(bucket.list(prefix="pandaset/"))
scores = list(score_recording(bucket, recording, settings))
assert all(score.tracks for score in scores) and len(scores) > 1
for each in gc.get_objects():
    if isinstance(each, Dispatcher) and each.stats.cache_path and each.stats.cache_misses:
        print("compiled here:", each.py_func.__qualname__)
"""


@pytest.mark.integration
@pytest.mark.reference
@pytest.mark.timeout(1800)
def test_the_first_process_that_mines_finds_every_loop_compiled(
    reference: Path, tmp_path: Path
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", MINE, (reference / "data" / "logs").as_uri()],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    assert "compiling loops" in ended.stdout + ended.stderr
    assert "compiled here" not in ended.stdout
    assert list(tmp_path.rglob("*.compiled"))
