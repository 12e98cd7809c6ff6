"""Frames of a log with poses, numbered as its truth numbers them."""

from collections.abc import Iterator

from schemas.frame import PosedFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.lab.evaluation.motion.disturbance import Disturbance
from workers.lab.evaluation.motion.stream_runner import run_streams
from workers.lab.evaluation.truth.truth import LogTruth
from workers.parts.protocols import Odometry


def posed_frames(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    *,
    odometry: Odometry,
    settings: MiningSettings,
    frames: range,
) -> Iterator[tuple[int, PosedFrame]]:
    """Yield the frames of a log with their numbers in the truth, from its first one on.

    Args:
        bucket: Bucket of the log.
        recording: The log.
        truth: Its truth.
        odometry: Odometry that poses the frames.
        settings: Ingest settings.
        frames: Frames to yield; earlier ones warm up the odometry.

    Raises:
        LogUnusableError: If the log cannot be mined.
        TruthUnusableError: If the truth does not know a frame.
    """
    outputs = run_streams(
        bucket,
        recording,
        truth,
        odometry=odometry,
        streams={},
        settings=settings,
        disturbance=Disturbance(),
    )
    for output in outputs:
        if output.number >= frames.stop:
            break
        if output.number in frames:
            yield output.number, output.posed
