"""Daemon of `counterpoint router`: a Zenoh router alone, without a state."""

from collections.abc import Callable
from functools import partial
from typing import Final

import zenoh

from schemas.runtime.process import stop_on_signals
from schemas.transport.bus import router_session
from schemas.transport.locks import OPEN, Locks
from service.background.heartbeat import Heartbeat, Standing

STOPPING: Final = "stopping: links are closed; a second Ctrl-C ends at once"


def run_router(
    listen: str,
    *,
    remark: Callable[[str], None],
    connect: str = "",
    heartbeat_s: float = 300.0,
    locks: Locks = OPEN,
) -> None:
    """Route until SIGTERM or SIGINT.

    Args:
        listen: Endpoints to listen on, separated by commas.
        remark: Called with a sentence that names the endpoints, and with one when a signal comes.
        connect: Other routers to link to, so that clients may list several and lose one.
        heartbeat_s: Longest silence of the log, seconds.
        locks: Certificates, and Zenoh's settings laid over ours.

    Raises:
        TransientError: If an endpoint is taken.
        PermanentError: If an endpoint cannot be listened on here at all.
    """
    others = connect.split(",") if connect else []
    with (
        stop_on_signals(partial(remark, STOPPING)) as stop,
        router_session(listen.split(","), connect=others, locks=locks) as session,
    ):
        remark(f"routing at {listen}")
        heartbeat = Heartbeat(lambda: _standing(session), heartbeat_s=heartbeat_s)
        while not stop.wait(heartbeat.interval_s):
            heartbeat.beat()


def _standing(session: zenoh.Session) -> Standing:
    kinds = [str(transport.whatami) for transport in session.info.transports()]
    return {"clients": kinds.count("client"), "routers": kinds.count("router")}
