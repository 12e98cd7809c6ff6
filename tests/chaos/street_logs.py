"""Logs that are mined in earnest: simulated streets, and what they give when nothing goes wrong."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from schemas.errors import ObjectChangedError
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.overlay_codec import MAX_OVERLAY_BYTES
from schemas.transport.recordings import group_recordings
from service.settings.config import load_settings
from tests.factories import street_log
from workers.mine import MinedRecord
from workers.score import score_recording

SHARD_S: Final = 2
SECONDS: Final = 6
"""Length of a shard and of a log, seconds."""

OPTIONS: Final = ("--shard-seconds", str(SHARD_S), "--supervised", "recorded")
"""Arguments of a service under which they are mined."""


@dataclass(slots=True)
class Undisturbed:
    """Records and overlays of an undisturbed run.

    Attributes:
        records: Record of each scene.
        overlays: Overlays by their keys.
    """

    records: dict[str, bytes] = field(default_factory=dict)
    overlays: dict[str, bytes] = field(default_factory=dict)

    def add(self, mined: MinedRecord) -> None:
        """Keep a scene."""
        self.records[mined.score.scene_id] = mined.record
        self.overlays[mined.overlay_key] = mined.overlay


class StreetLogs:
    """Small logs of simulated streets in a bucket, one vehicle and street each."""

    shards_per_log = SECONDS // SHARD_S

    def __init__(self, folder: Path, *, logs: Bucket, overlays: Bucket) -> None:
        """Keep the buckets.

        Args:
            folder: For a copy of each log.
            logs: Bucket of the logs.
            overlays: Bucket of their overlays.
        """
        folder.mkdir()
        self._folder, self._logs, self._overlays = folder, logs, overlays
        self.url, self.artifacts = logs.url, overlays.url

    def add(self, log_id: str) -> None:
        """Write a log, and upload it."""
        number = int(log_id.rpartition("-")[2])
        path = self._folder / f"{log_id}.mcap"
        street_log(path, frames=10 * SECONDS, seed=number, style="stands", vehicle=log_id)
        self._logs.put(path.name, path.read_bytes())

    def undisturbed(self) -> Undisturbed:
        """Mine all logs in this process."""
        place = str(self._folder)
        settings = load_settings(bucket=place, grid={"shard_s": SHARD_S}, supervised="recorded")
        bucket, found = open_bucket(place), Undisturbed()
        for recording in group_recordings(bucket.list()):
            for _ in score_recording(bucket, recording, settings.mining(), on_scene=found.add):
                pass
        return found

    def wrong_overlays(self, expected: dict[str, bytes]) -> list[str]:
        """Return the keys of the overlays that are missing or differ."""
        return [key for key, overlay in expected.items() if self._read(key) != overlay]

    def _read(self, key: str) -> bytes | None:
        try:
            return self._overlays.read_all(key, at_most=MAX_OVERLAY_BYTES)
        except ObjectChangedError:
            return None
