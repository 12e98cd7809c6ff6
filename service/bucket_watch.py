"""The log bucket, listed and taken over; the service opens no object of it."""

from pathlib import Path
from urllib.parse import unquote, urlsplit

import structlog

from schemas.bucket import Bucket
from schemas.errors import BucketUnreachableError
from schemas.recordings import group_recordings
from service.ledger import Ledger, SyncResult

log = structlog.get_logger(__name__)


class BucketWatch:
    """Tells the ledger what lies in the bucket.

    Attributes:
        recordings: How many recordings the last listing held; None before the first.
    """

    def __init__(self, bucket: Bucket, ledger: Ledger) -> None:
        self._bucket, self._ledger = bucket, ledger
        self.recordings: int | None = None

    def list_once(self) -> SyncResult:
        """List the bucket and take the listing over.

        Raises:
            BucketUnreachableError: If the store does not answer, or a local folder is gone.
            BucketRefusedError: If it says no.
        """
        _need_folder(self._bucket.url)
        found = group_recordings(self._bucket.list())
        result = self._ledger.sync_recordings(found)
        if not found and self.recordings != 0:
            log.warning("no logs in the bucket", bucket=self._bucket.url)
        self.recordings = len(found)
        if result.new or result.replaced or result.deleted:
            log.info(
                "bucket listed",
                recordings=len(found),
                new=len(result.new),
                replaced=len(result.replaced),
                deleted=len(result.deleted),
            )
        return result


def _need_folder(url: str) -> None:
    """A folder that is gone lists as an empty one: its logs must not count as deleted."""
    parts = urlsplit(url)
    if parts.scheme == "file" and not Path(unquote(parts.path)).is_dir():
        raise BucketUnreachableError(
            f"the folder of the logs is gone; is its disk mounted? ({url})"
        )
