"""Worker configuration and observer: the part of a worker that its pool has to load."""

from dataclasses import dataclass
from typing import Final

from schemas.transport import keys
from schemas.transport.locks import OPEN, Locks

DRAIN_S: Final = 20.0
"""Time to finish a shard after a stop, seconds; systems kill a process after 30 s."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """Places in the worker's own settings; no other place is accepted from another machine.

    Attributes:
        bucket: URL or path of the logs.
        artifacts: URL or path for overlays.
        model: Adapter of one's own model, or a folder it is in; empty: none is loaded.
        weights: Folder of weights, or one it is in; empty: only those that ship.
        predictions: Folder or bucket with a model's answers, or one it is in; empty: none is read.
    """

    bucket: str = ""
    artifacts: str = ""
    model: str = ""
    weights: str = ""
    predictions: str = ""


@dataclass(frozen=True, slots=True)
class WorkerConfig:
    """Settings that a worker needs before it can ask the service for the others.

    Attributes:
        worker_id: Unique; the ids of one pool share a prefix.
        connect: Endpoints of routers.
        root: First part of every key.
        drain_s: Time to work on a lease after a stop, seconds.
        accepts: Places that the service may name, where a router is on another machine.
        locks: Certificates of the session.
    """

    worker_id: str
    connect: tuple[str, ...]
    root: str = keys.DEFAULT_ROOT
    drain_s: float = DRAIN_S
    accepts: Accepted = Accepted()
    locks: Locks = OPEN

    @property
    def is_named(self) -> bool:
        """True if the id begins with the name of the certificate, to which rules bind it."""
        return bool(self.locks.name) and self.worker_id.startswith(
            f"{self.locks.name}{keys.OWNER_END}"
        )


class WorkerObserver:
    """Receives the state of a worker for the process that started it; does nothing by default."""

    def connected(self, connected: bool) -> None:
        """Receive the presence of a router, at the beginning and at every change."""

    def equipped(self, pipeline_version: str) -> None:
        """Receive the pipeline version once the worker can mine for the service; empty if not."""

    def working(self, working: bool) -> None:
        """Receive true when work on a lease begins and false when it ends."""
