"""What can be wrong with a log; `schemas.errors` says what transient and permanent mean."""

from schemas.errors import PermanentError


class ChunkUnreadableError(PermanentError):
    """A chunk's bytes are not what they should be."""

    def __init__(self, *, key: str, offset: int, length: int, problem: str) -> None:
        """Keep the parts: the log line, the damage record and the message all need them."""
        super().__init__(f"cannot read chunk: {problem} ({key} at byte {offset})")
        self.key, self.offset, self.length, self.problem = key, offset, length, problem


class CloudUnreadableError(PermanentError):
    """A message is no well-formed point cloud."""


class LogUnusableError(PermanentError):
    """A log cannot be mined at all: no lidar in it, or parts that contradict each other."""


class NotMcapError(PermanentError):
    """The object is not an MCAP file, or nothing of it can be read."""


class UnknownPartError(PermanentError):
    """A replaceable part is asked for by a name that no implementation has."""


class TasksDifferError(PermanentError):
    """Two streams were chosen that answer different questions."""
