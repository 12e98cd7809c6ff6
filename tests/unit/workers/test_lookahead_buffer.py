import pytest

from schemas.errors import CounterpointError
from schemas.labels import FrameHealth
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from tests.factories import frame
from tests.tiny_logs import Recorder, drive, only_recording, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.parts.registry import build_parts
from workers.selfsupervised.labelling import unknown_labels
from workers.selfsupervised.lookahead_buffer import BufferedFrame, LookaheadBuffer

AHEAD = "registration:lookahead-1.0"


def waiting(at_s: float, *, restarts: bool = False) -> BufferedFrame:
    posed = frame([[1.0, 0.0, 0.0]], at_s=at_s)
    return BufferedFrame(posed, unknown_labels(posed, health=FrameHealth()), restarts=restarts)


def stamps(released: object) -> list[float]:
    assert hasattr(released, "__iter__")
    return [round(each.frame.stamp_ns * 1e-9 % 100, 2) for each, _ in released]


def test_without_a_lookahead_no_frame_waits() -> None:
    ahead = LookaheadBuffer(0.0)
    for k in range(5):
        assert len(stamps(ahead.add(waiting(0.1 * k)))) == 1
    assert stamps(ahead.flush()) == []


@pytest.mark.parametrize("period_s", [0.05, 0.1, 0.2])
def test_a_frame_waits_for_half_a_second_whatever_the_rate(period_s: float) -> None:
    ahead, released = LookaheadBuffer(0.5), 0
    for k in range(20):
        released += len(stamps(ahead.add(waiting(period_s * k))))
        held_s = period_s * (k + 1 - released)
        assert held_s <= 0.5 + period_s
    assert len(stamps(ahead.flush())) == 20 - released


def test_a_sensor_of_any_rate_holds_only_so_many_frames() -> None:
    ahead, released = LookaheadBuffer(1.0), 0
    for k in range(100):
        released += len(stamps(ahead.add(waiting(0.001 * k))))
    assert 100 - released == 24


def test_where_frames_begin_anew_those_before_wait_no_longer() -> None:
    ahead = LookaheadBuffer(1.0)
    assert stamps(ahead.add(waiting(0.0))) == stamps(ahead.add(waiting(0.1))) == []
    assert len(stamps(ahead.add(waiting(5.0, restarts=True)))) == 2


def mining(name: str) -> MiningSettings:
    return MiningSettings(bucket="memory://", artifacts="memory://", selfsupervised=name)


def test_the_name_of_a_stream_says_how_far_it_looks_ahead() -> None:
    assert mining("registration").ahead_ns == 0
    assert mining("registration:lookahead-0.5").ahead_ns == 500_000_000
    with pytest.raises(ValueError, match="must end in seconds"):
        mining("registration:lookahead-soon")


def test_shards_are_read_as_far_as_labels_look_ahead() -> None:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", Recorder(chunk_bytes=20_000).write(drive(10)))
    using = settings(shard_s=4.0).model_copy(update={"selfsupervised": AHEAD})
    recording = only_recording(bucket)
    first, *_, last = plan_recording(bucket, recording, using).shards
    frames = list(read_shard(bucket, recording, first, using).frames())
    assert frames[-1].stamp_ns == first.end_ns + 900_000_000
    assert last.lookahead_end_ns == last.end_ns


def test_a_lookahead_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(CounterpointError, match=r"registration:lookahead-1\.0"):
        build_parts(
            odometry="kiss-icp",
            supervised="recorded",
            selfsupervised="registration:lookahead-7.0",
        )
