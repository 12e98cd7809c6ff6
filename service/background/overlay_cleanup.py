"""Deletion of the overlays of scenes withdrawn long ago, where the settings ask for it.

Only objects named in the ledger are deleted.
"""

from collections.abc import Sequence
from threading import Event
from typing import Final

import structlog

from schemas.overlay import overlay_key
from schemas.transport.bucket import Bucket
from service.errors import UsageError
from service.store.ledger import Ledger
from service.store.retirement import SceneOverlay

log = structlog.get_logger(__name__)

DAY_S: Final = 86_400.0
BATCH: Final = 100
"""Overlays per query of the ledger; one that is needed again by then is kept."""

LONGEST_INTERVAL_S: Final = 3600.0
SHORTEST_INTERVAL_S: Final = 1.0


def need_apart(artifacts: Bucket, log_bucket_url: str, *, setting: str) -> None:
    """Check that overlays are deleted where no logs lie.

    Raises:
        UsageError: If one of the two places lies in the other.
    """
    places = sorted((f"{artifacts.url.rstrip('/')}/", f"{log_bucket_url.rstrip('/')}/"))
    if places[1].startswith(places[0]):
        raise UsageError(
            f"{setting} deletes overlays, and nothing may be deleted where logs lie: "
            f"artifacts ({artifacts.url}) and bucket ({log_bucket_url}) lie in each other; "
            "name another place with --artifacts, or leave the setting out"
        )


class OverlaySweep:
    """Deletes overlays that have been unused for a given time; resumes after a kill.

    Attributes:
        interval_s: Interval of sweeps, seconds.
        deleted: Overlays deleted by this process.
    """

    def __init__(
        self,
        artifacts: Bucket,
        ledger: Ledger,
        *,
        keep_s: float,
        log_bucket_url: str,
        keep_pipelines: Sequence[str] = (),
    ) -> None:
        """Keep the artifacts bucket and the ledger.

        Args:
            artifacts: Bucket of the overlays.
            ledger: Knows the current scenes, and since when others are withdrawn.
            keep_s: Time for which an overlay is kept after its scene was withdrawn, seconds;
                counted from the first sweep that saw it.
            log_bucket_url: URL of the log bucket.
            keep_pipelines: First characters of pipeline versions that lose no overlay.

        Raises:
            UsageError: If one of the two places lies in the other, since nothing is ever deleted in
                the log bucket.
        """
        need_apart(artifacts, log_bucket_url, setting="keep_withdrawn_days")
        self._artifacts, self._ledger, self._keep_s = artifacts, ledger, keep_s
        self._keep_pipelines = tuple(keep_pipelines)
        self.interval_s = min(LONGEST_INTERVAL_S, max(SHORTEST_INTERVAL_S, keep_s / 10))
        self.deleted = 0

    def sweep(self, stop: Event) -> None:
        """Mark overlays that have become unused, and delete those unused for long enough.

        Raises:
            TransientError: If artifacts or database do not answer now.
            BucketRefusedError: If the artifacts may not be deleted.
        """
        self._ledger.retired_overlays.note()
        before = self.deleted
        try:
            while not stop.is_set() and self._delete_some():
                pass
        finally:
            if self.deleted > before:
                log.info(
                    "overlays of withdrawn scenes deleted",
                    overlays=self.deleted - before,
                    keep_withdrawn_days=self._keep_s / DAY_S,
                )

    def _delete_some(self) -> int:
        overlays = self._ledger.retired_overlays.to_delete(
            keep_s=self._keep_s, keep_pipelines=self._keep_pipelines, limit=BATCH
        )
        for each in overlays:
            self._artifacts.delete(key_of(each))
            self.deleted += 1
        self._ledger.retired_overlays.note_deleted(overlays)
        return len(overlays)


def key_of(overlay: SceneOverlay) -> str:
    """Return the key of an overlay in the artifacts bucket."""
    return overlay_key(
        log_id=overlay.log_id,
        scene_id=overlay.scene_id,
        pipeline_version=overlay.pipeline_version,
        sha256=overlay.sha256,
    )
