"""Labels of the model on the car, from a written log to the frames of its shards."""

from io import BytesIO
from typing import Literal

import numpy as np
import pytest

from schemas.mining import Grid, MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import SMALL_LIDAR
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.simulation.faults.recorded import record
from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street


@pytest.mark.parametrize("recorded", ["fields", "topic"])
@pytest.mark.parametrize("shard_s", [2.0, 20.0])
def test_labels_read_from_a_log_equal_the_labels_written(
    recorded: Literal["fields", "topic"], shard_s: float
) -> None:
    street = build_street(seed=1, seconds=4.0)
    lidar = SMALL_LIDAR
    out = BytesIO()
    write_log(out, street, lidar=lidar, recorded=recorded, chunk_bytes=60_000)
    bucket = open_bucket("memory://")
    bucket.put("log.mcap", out.getvalue())
    recording = group_recordings(bucket.list())[0]
    settings = MiningSettings(
        bucket="memory://",
        artifacts="memory://",
        grid=Grid(shard_s=shard_s),
        supervised="recorded",
    )
    plan = plan_recording(bucket, recording, settings)
    assert not plan.refused
    seen = 0
    for shard in plan.shards:
        for frame in read_shard(bucket, recording, shard, settings).frames():
            index = round((frame.stamp_ns - shard.anchor_ns) / lidar.period_ns)
            written = record(street, sweep(street, lidar, index), ())
            assert frame.recorded is not None
            assert frame.recorded.motion is not None
            assert frame.recorded.confidence is not None
            np.testing.assert_array_equal(frame.recorded.class_id, written.label)
            np.testing.assert_array_equal(frame.recorded.motion, written.motion)
            np.testing.assert_array_equal(frame.recorded.confidence, written.confidence)
            assert frame.recorded.classes
            seen += 1
    assert seen >= 40
