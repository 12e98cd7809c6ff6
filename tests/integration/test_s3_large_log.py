"""An indexed log of four gigabytes on an S3 server, opened in three requests."""

from pathlib import Path

import pytest

from schemas.transport.bucket import open_bucket
from tests.integration.small_s3 import SmallS3
from tests.tiny_logs import Recorder, drive, only_recording, settings
from workers.ingest.plan import plan_recording

pytestmark = pytest.mark.integration

CHUNKS_BYTES = 1 << 32
HOLE_BYTES = 40 << 20


def test_an_indexed_log_of_four_gigabytes_is_planned_in_three_requests(tmp_path: Path) -> None:
    folder = tmp_path / "fleet" / "car-7"
    folder.mkdir(parents=True)
    log = folder / "drive.mcap"
    recorder = Recorder(chunk_bytes=130_000, metadata={"counterpoint.log": {"vehicle": "car-7"}})
    recorder.write_sparse(log, drive(110), hole_bytes=HOLE_BYTES)
    assert log.stat().st_size > CHUNKS_BYTES
    with SmallS3(tmp_path) as s3:
        options = {name.lower(): value for name, value in s3.environment.items()}
        bucket = open_bucket("s3://fleet", options=options)
        recording = only_recording(bucket)
        listed = len(s3.asked)
        plan = plan_recording(bucket, recording, settings())
    assert plan.refused == ""
    assert plan.vehicle == "car-7"
    assert not plan.damage
    assert len(plan.shards) == 6
    asked = s3.asked[listed:]
    assert len(asked) == plan.range_reads
    assert len(asked) <= 3, asked
    assert plan.bytes_read < 8 << 20
