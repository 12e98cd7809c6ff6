"""Errors of a log and its parts; `schemas.errors` defines transient and permanent ones."""

from schemas.errors import PermanentError


class ChunkUnreadableError(PermanentError):
    """A chunk's bytes are invalid."""

    def __init__(self, *, key: str, offset: int, length: int, problem: str) -> None:
        """Keep the fields: the log line, the damage record and the message all need them."""
        super().__init__(f"cannot read chunk: {problem} ({key} at byte {offset})")
        self.key, self.offset, self.length, self.problem = key, offset, length, problem


class CloudUnreadableError(PermanentError):
    """A message is no well-formed point cloud."""


class LogUnusableError(PermanentError):
    """A log cannot be mined at all: no lidar in it, or parts that contradict each other."""


class PredictionsMissingError(LogUnusableError):
    """There are no predictions next to a log, or not yet."""


class NotMcapError(PermanentError):
    """The object is not an MCAP file, or nothing of it can be read."""


class UnknownPartError(PermanentError):
    """A replaceable part has a name that no implementation has."""


class TasksDifferError(PermanentError):
    """Two streams of different tasks were chosen."""
