"""Work that a service has left, asked over the bus: the measure of a pool that follows it."""

from typing import Final

import zenoh

from schemas.backlog import WorkBacklog
from schemas.transport import keys
from schemas.transport.ask import ask
from schemas.transport.wire import decode_reply

_BACKLOG_S: Final = 2.0
"""Time for the answer of a service, seconds."""


def work_left(session: zenoh.Session, root: str) -> int:
    """Ask the service for the number of plans and shards that wait or are leased."""
    key = keys.control(root=root, verb="backlog")
    found = decode_reply(WorkBacklog, ask(session, key, timeout_s=_BACKLOG_S), to="backlog")
    return found.waiting + found.leased
