"""What a worker is told, and what it tells: all of a worker that its pool has to load."""

from dataclasses import dataclass
from typing import Final

from schemas.transport import keys

DRAIN_S: Final = 20.0
"""A worker told to stop finishes its shard if that takes no longer; systems kill after 30 s."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """What the settings of the worker itself name: nothing else is accepted from afar.

    Attributes:
        bucket: URL or path of the logs.
        artifacts: URL or path for overlays.
        model: Adapter of one's own model, or a folder it lies in; empty: none is loaded.
        weights: Folder of weights, or one it lies in; empty: only those that ship.
    """

    bucket: str = ""
    artifacts: str = ""
    model: str = ""
    weights: str = ""


@dataclass(frozen=True, slots=True)
class WorkerConfig:
    """What a worker must know before it can ask the service for the rest.

    Attributes:
        worker_id: Unique; the ids of one pool share a prefix.
        connect: Endpoints of routers.
        root: First part of every key.
        drain_s: How long a lease may still be worked on after being told to stop, seconds.
        accepts: Which places the service may name, where a router is on another machine.
    """

    worker_id: str
    connect: tuple[str, ...]
    root: str = keys.DEFAULT_ROOT
    drain_s: float = DRAIN_S
    accepts: Accepted = Accepted()


class WorkerObserver:
    """What a worker tells whoever started it; does nothing until it is overridden."""

    def connected(self, connected: bool) -> None:
        """Told whether a router is there, at the beginning and at every change."""

    def equipped(self, pipeline_version: str) -> None:
        """Told when the worker can mine what the service asks for, and as what."""

    def working(self, working: bool) -> None:
        """Told true when work on a lease begins and false when it ends."""
