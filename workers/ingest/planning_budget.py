"""Planning budget: bytes and records that planning may open, so that no file takes minutes."""

from dataclasses import dataclass

from workers.ingest.limits import (
    MAX_OPENED_BYTES,
    MAX_RECORDS_HOPPED,
    MAX_RECORDS_OPENED,
    MAX_STORED_BYTES,
)


@dataclass(slots=True)
class PlanningBudget:
    """Budget left for one recording, all its parts together.

    Attributes:
        stored_bytes: Stored bytes of chunks that may be read.
        opened_bytes: Bytes that they may grow to.
        records: Records in them that may be examined.
        hops: Records, and candidates for one, outside any index.
    """

    stored_bytes: int = MAX_STORED_BYTES
    opened_bytes: int = MAX_OPENED_BYTES
    records: int = MAX_RECORDS_OPENED
    hops: int = MAX_RECORDS_HOPPED

    @property
    def spent(self) -> str:
        """Return why no more chunks are opened; empty while they are."""
        for left, most, what in (
            (self.stored_bytes, MAX_STORED_BYTES, "stored bytes"),
            (self.opened_bytes, MAX_OPENED_BYTES, "opened bytes"),
            (self.records, MAX_RECORDS_OPENED, "records"),
        ):
            if left <= 0:
                return f"it was not opened: planning opens chunks of {most} {what} in all"
        return ""
