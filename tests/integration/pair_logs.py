"""Logs of a pair of services: where they lie, and how another is uploaded."""

from pathlib import Path
from typing import Protocol

from tests.integration.quick_miner import SHARDS_PER_LOG


class PairLogs(Protocol):
    """A bucket of logs, and the place of their overlays.

    Attributes:
        url: URL or path of the bucket.
        artifacts: URL or path for overlays.
        shards_per_log: Number of shards of each log.
    """

    url: str
    artifacts: str
    shards_per_log: int

    def add(self, log_id: str) -> None:
        """Upload a log."""
        ...


class UnopenedLogs:
    """Logs for quick miners, which open none, in a folder."""

    shards_per_log = SHARDS_PER_LOG

    def __init__(self, folder: Path) -> None:
        """Make the bucket within a folder."""
        self.url, self.artifacts = str(folder / "logs"), str(folder / "overlays")
        Path(self.url).mkdir()

    def add(self, log_id: str) -> None:
        """Upload a log."""
        (Path(self.url) / f"{log_id}.mcap").write_bytes(b"never opened")
