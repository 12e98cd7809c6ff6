"""Raw messages of a log, before decoding."""

from dataclasses import dataclass
from typing import Final

from schemas.work import Channel

MAX_TIME_NS: Final = 2**62
"""Latest valid time, in the year 2116; a later one is damage, and exceeds a database's integer."""


@dataclass(frozen=True, slots=True, eq=False)
class RawMessage:
    """One recorded message, its bytes not yet decoded.

    Attributes:
        channel: Topic, encodings and schema it was recorded with.
        log_time_ns: Its log time, nanoseconds since the Unix epoch.
        data: Its payload; a view into a chunk's buffer, so keep it no longer than needed.
    """

    channel: Channel
    log_time_ns: int
    data: bytes | memoryview
