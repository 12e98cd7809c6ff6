"""What a worker is told, and what it tells: all of a worker that its pool has to load."""

from dataclasses import dataclass
from typing import Final

from schemas import keys

DRAIN_S: Final = 20.0
"""A worker told to stop finishes its shard if that takes no longer; systems kill after 30 s."""


@dataclass(frozen=True, slots=True)
class WorkerConfig:
    """What a worker must know before it can ask the service for the rest.

    Attributes:
        worker_id: Unique; the ids of one pool share a prefix.
        connect: Endpoints of routers.
        root: First part of every key.
        drain_s: How long a lease may still be worked on after being told to stop, seconds.
    """

    worker_id: str
    connect: tuple[str, ...]
    root: str = keys.DEFAULT_ROOT
    drain_s: float = DRAIN_S


class WorkerObserver:
    """What a worker tells whoever started it; does nothing until it is overridden."""

    def connected(self, connected: bool) -> None:
        """Told whether a router is there, at the beginning and at every change."""

    def equipped(self, pipeline_version: str) -> None:
        """Told when the worker can mine what the service asks for, and as what."""

    def working(self, working: bool) -> None:
        """Told true when work on a lease begins and false when it ends."""
