"""Source of excerpts: opens the logs of a bucket, one after the other."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from schemas.errors import PermanentError
from schemas.excerpt import ExcerptMessage
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.bucket import Bucket
from schemas.transport.recordings import group_recordings
from workers.excerpt.cutting import CutExcerpt, OpenedLog, open_log
from workers.excerpt.writing import write_mcap


class LogGoneError(PermanentError):
    """The bucket no longer has the log of a scene."""


class BucketExcerpts:
    """Excerpts of the logs of one bucket; the index of the last log is kept."""

    def __init__(self, bucket: Bucket) -> None:
        """Keep the bucket; nothing is read yet."""
        self._bucket = bucket
        self._last: tuple[str, OpenedLog] | None = None

    def cut(self, score: SceneScore, overlay: Overlay) -> CutExcerpt:
        """Find the log of a scene.

        Raises:
            LogGoneError: If the bucket no longer has it.
            NotMcapError: If it is no MCAP file.
            FramesMissingError: If it has no cloud of the scene's lidar.
        """
        return CutExcerpt(self._opened(score.log_id), overlay, lidar_topic=score.lidar_topic)

    def write_mcap(
        self,
        path: Path,
        messages: Iterable[ExcerptMessage],
        *,
        metadata: Iterable[tuple[str, Mapping[str, str]]],
        attachments: Iterable[tuple[str, str, bytes]],
    ) -> None:
        """Write an MCAP file; see `workers.excerpt.writing.write_mcap`."""
        write_mcap(path, messages, metadata=metadata, attachments=attachments)

    def _opened(self, log_id: str) -> OpenedLog:
        if self._last is None or self._last[0] != log_id:
            folder = log_id.rpartition("/")[0]
            listed = group_recordings(self._bucket.list(prefix=folder))
            recording = next((each for each in listed if each.log_id == log_id), None)
            if recording is None:
                raise LogGoneError(f"no log {log_id} in {self._bucket.url}")
            self._last = (log_id, open_log(self._bucket, recording))
        return self._last[1]
