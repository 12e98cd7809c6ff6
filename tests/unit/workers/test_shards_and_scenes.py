"""From bytes to scenes: how a log is cut into shards and chunks never shows in its scenes."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.transport.bucket import open_bucket
from tests.tiny_logs import BEGIN_NS, LIDAR, Recorder, Said, cloud, only_recording, ring, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.ingest.scenes import cut_scenes

Scenes = list[tuple[str, tuple[int, ...], bool]]

FEW = np.random.default_rng(0).uniform(-20, 20, (4, 3)).astype("<f4").tobytes()


def message(at_ns: int, delay_ns: int) -> Said:
    """A cloud of few points: the lidar is configured, so nothing asks what it looks like."""
    return Said(LIDAR, at_ns + delay_ns, cloud(at_ns, FEW, ("x", "y", "z")))


def stretches(chance: np.random.Generator, seconds: float) -> Iterator[int]:
    """Stamps of a lidar that falls silent now and then, for less or more than a gap."""
    at_s = 0.0
    while at_s < seconds:
        for _ in range(int(chance.choice([3, 8, 12, 25, 60]))):
            yield BEGIN_NS + round(at_s * NS_PER_S)
            at_s += 0.1
        at_s += float(chance.choice([0.25, 0.45, 0.7, 2.3]))


def labelled(frame: LidarFrame) -> LabelledFrame:
    unknown = np.zeros(len(frame), dtype=np.uint8)
    labels = FrameLabels(unknown.copy(), np.zeros(len(frame), dtype=np.float16))
    return LabelledFrame(PosedFrame(frame, np.eye(4)), labels, labels, unknown.copy())


def scenes_of(
    data: bytes, *, shard_s: float, scene_s: float, selfsupervised: str = "registration"
) -> Scenes:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", data)
    recording = only_recording(bucket)
    chosen = {"lidar_topic": LIDAR, "selfsupervised": selfsupervised}
    using = settings(shard_s=shard_s, scene_s=scene_s).model_copy(update=chosen)
    plan = plan_recording(bucket, recording, using)
    assert plan.refused == ""
    found: Scenes = []
    for shard in plan.shards:
        frames = map(labelled, read_shard(bucket, recording, shard, using).frames())
        found += [
            (scene.scene_id, tuple(each.stamp_ns for each in scene.frames), scene.too_short)
            for scene in cut_scenes(shard, frames)
        ]
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("frames_per_chunk", [2, 12])
def test_scenes_are_the_same_for_any_shards_and_hold_every_frame_once(
    seed: int, frames_per_chunk: int
) -> None:
    chance = np.random.default_rng(seed)
    stamps = list(stretches(chance, 25))
    jitter_ns = int(chance.choice([1, 80_000_000]))
    delay_ns = int(chance.choice([0, 120_000_000]))
    messages = [message(at_ns, delay_ns + int(chance.integers(0, jitter_ns))) for at_ns in stamps]
    messages.sort(key=lambda said: said.log_time_ns)
    data = Recorder(chunk_bytes=200 * frames_per_chunk).write(messages)
    whole = scenes_of(data, shard_s=60, scene_s=2)
    assert sorted(at_ns for _, found, _ in whole for at_ns in found) == stamps
    assert len({scene_id for scene_id, _, _ in whole}) == len(whole)
    for shard_s in (2, 4, 20):
        assert scenes_of(data, shard_s=shard_s, scene_s=2) == whole


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lookahead", ["0.5", "1.0"])
@pytest.mark.parametrize("scene_s", [0.5, 2.0])
def test_frames_that_are_read_for_labels_only_change_no_scene(
    seed: int, lookahead: str, scene_s: float
) -> None:
    stamps = stretches(np.random.default_rng(seed), 25)
    data = Recorder(chunk_bytes=400).write([message(at_ns, 0) for at_ns in stamps])
    whole = scenes_of(data, shard_s=60, scene_s=scene_s)
    for shard_s in (scene_s, 4.0):
        ahead = f"registration:lookahead-{lookahead}"
        assert scenes_of(data, shard_s=shard_s, scene_s=scene_s, selfsupervised=ahead) == whole


def test_frames_of_chunks_that_overlap_in_time_reach_their_scenes() -> None:
    stamps = [BEGIN_NS + number * 10**8 for number in range(100)]
    messages = [replace(message(at_ns, 0), data=ring(at_ns)) for at_ns in stamps]
    mixed = [*messages[0:50:2], *messages[1:50:2], *messages[50:100:2], *messages[51:100:2]]
    data = Recorder(chunk_bytes=100_000).write(mixed)
    whole = scenes_of(data, shard_s=20, scene_s=2)
    assert [len(found) for _, found, _ in whole] == [20, 20, 20, 20, 20]
    assert scenes_of(data, shard_s=2, scene_s=2) == whole
