"""Disk budget of the artifacts: overlays are deleted while they exceed it, the least needed first.

First go overlays of withdrawn scenes, the oldest first, then those of current scenes, the lowest
score first. Those of selected or judged scenes are never deleted.
"""

from collections.abc import Callable, Sequence
from functools import partial
from threading import Event
from typing import Final

import structlog

from schemas.transport.bucket import Bucket
from service.background.overlay_cleanup import BATCH, key_of, need_apart
from service.store.ledger import Ledger
from service.store.retirement import SceneOverlay

log = structlog.get_logger(__name__)

INTERVAL_S: Final = 1800.0
"""Interval at which the artifacts are listed, seconds; for so long a budget may be exceeded."""


class OverlayBudget:
    """Keeps the overlays within a number of bytes.

    Attributes:
        interval_s: Interval of listings, seconds.
        deleted: Overlays deleted by this process.
        used_bytes: Bytes of the overlays after the last sweep; None before the first.
        budget_bytes: Most bytes.
    """

    interval_s = INTERVAL_S

    def __init__(
        self,
        artifacts: Bucket,
        ledger: Ledger,
        *,
        budget_bytes: int,
        log_bucket_url: str,
        keep_pipelines: Sequence[str] = (),
    ) -> None:
        """Keep the artifacts bucket and the ledger.

        Args:
            artifacts: Bucket of the overlays.
            ledger: Knows scenes, their scores, selections and verdicts.
            budget_bytes: Most bytes of all overlays.
            log_bucket_url: URL of the log bucket.
            keep_pipelines: First characters of pipeline versions that lose no overlay.

        Raises:
            UsageError: If one of the two places lies in the other, since nothing is ever deleted in
                the log bucket.
        """
        need_apart(artifacts, log_bucket_url, setting="artifacts_budget_bytes")
        self._artifacts, self._ledger = artifacts, ledger
        self._keep_pipelines = tuple(keep_pipelines)
        self.budget_bytes, self.deleted = budget_bytes, 0
        self.used_bytes: int | None = None

    def sweep(self, stop: Event) -> None:
        """List the overlays, and delete the least needed ones while they exceed the budget.

        Raises:
            TransientError: If artifacts or database do not answer now.
            BucketRefusedError: If the artifacts may not be listed or deleted.
        """
        used = sum(found.size for found in self._artifacts.list(prefix="overlays"))
        before, retired = self.deleted, self._ledger.retired_overlays
        if used > self.budget_bytes:
            retired.note()
            for least_needed in (partial(retired.to_delete, keep_s=0.0), retired.low_ranked):
                chosen = partial(least_needed, limit=BATCH, keep_pipelines=self._keep_pipelines)
                used = self._delete(chosen, used, stop)
        self.used_bytes = used
        if self.deleted > before:
            log.warning(
                "overlays deleted to keep the disk budget",
                overlays=self.deleted - before,
                bytes=used,
                artifacts_budget_bytes=self.budget_bytes,
            )
        if used > self.budget_bytes and not stop.is_set():
            log.warning(
                "overlays exceed the disk budget: the rest is selected, judged, kept or unknown",
                bytes=used,
                artifacts_budget_bytes=self.budget_bytes,
            )

    def _delete(
        self, least_needed: Callable[[], list[SceneOverlay]], used: int, stop: Event
    ) -> int:
        """Delete overlays while they exceed the budget; gives the bytes that are left."""
        while used > self.budget_bytes and not stop.is_set() and (batch := least_needed()):
            gone: list[SceneOverlay] = []
            try:
                for overlay in batch:
                    if used <= self.budget_bytes:
                        break
                    key = key_of(overlay)
                    found = self._artifacts.head(key)
                    if found is not None:
                        self._artifacts.delete(key)
                        used -= found.size
                        self.deleted += 1
                    gone.append(overlay)
            finally:
                self._ledger.retired_overlays.note_deleted(gone)
        return used
