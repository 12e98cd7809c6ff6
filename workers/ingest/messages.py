"""One message as it lies in a log, before anything is made of its bytes."""

from dataclasses import dataclass
from typing import Final

from schemas.work import Channel

MAX_TIME_NS: Final = 2**62
"""In the year 2116: what claims to be later is damage, and would not fit a database's integer."""


@dataclass(frozen=True, slots=True, eq=False)
class RawMessage:
    """One recorded message, its bytes not yet decoded.

    Attributes:
        channel: Topic, encodings and schema it was recorded with.
        log_time_ns: When it was recorded, nanoseconds since the Unix epoch.
        data: Its payload; a view into a chunk's buffer, so keep it no longer than needed.
    """

    channel: Channel
    log_time_ns: int
    data: bytes | memoryview
