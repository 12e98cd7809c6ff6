"""Zenoh sessions and publishers, in the one configuration that was measured to survive kills.

All processes are clients of routers, since peers behind a router do not reach each other. Shared
memory is off, because killed processes leave it locked. Scouting is off, so that no test or
neighbouring fleet is ever joined by accident. Interfaces that `zenoh.ext` marks unstable are used
here only.
"""

import json
import socket
from collections.abc import Callable, Sequence
from threading import Event
from typing import Any, Final

import structlog
import zenoh
import zenoh.ext

from schemas.errors import PermanentError, TransientError
from schemas.runtime.retry import backoff_s, pause
from schemas.transport.endpoints import is_own
from schemas.transport.locks import OPEN, Locks, check_locks, lay_locks
from schemas.transport.wire import (
    RANKED_SCENE_ENCODING,
    SCENE_SCORE_ENCODING,
    SCENE_SCORE_V1_ENCODING,
    is_of_version_1,
)
from schemas.verdict import VERDICT_ENCODING

log = structlog.get_logger(__name__)

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Default endpoint on which a router listens and which clients connect to."""

HEARTBEAT_S: Final = 0.2
"""Delay after the last put of a burst until a subscriber learns of missed samples, seconds."""

SERVICE_LINK_S: Final = 4.0
"""Silence after which a router drops a service that has a standby, seconds. Until then requests go
to the frozen one; a busy machine must not be taken for a frozen one.
"""

CACHE_SAMPLES: Final = 128
"""Records that a publisher caches for a subscriber that missed some; a shard has about 12 to 24."""

RECORD: Final = zenoh.Encoding(SCENE_SCORE_ENCODING[0]).with_schema(SCENE_SCORE_ENCODING[1])
"""Encoding of a scored scene."""

RECORD_V1: Final = zenoh.Encoding(SCENE_SCORE_V1_ENCODING[0]).with_schema(
    SCENE_SCORE_V1_ENCODING[1]
)
"""Encoding of a scored scene that an earlier service stored."""

RANKED: Final = zenoh.Encoding(RANKED_SCENE_ENCODING[0]).with_schema(RANKED_SCENE_ENCODING[1])
"""Encoding of one scene of a selection."""


VERDICT: Final = zenoh.Encoding(VERDICT_ENCODING[0]).with_schema(VERDICT_ENCODING[1])
"""Encoding of one verdict."""


def encoding_of(record: bytes) -> zenoh.Encoding:
    """Return the encoding of a stored record, by its version."""
    return RECORD_V1 if is_of_version_1(record) else RECORD


def free_endpoint(host: str = "127.0.0.1") -> str:
    """Find an endpoint on which no process listens; another process may still take it first."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return f"tcp/{host}:{probe.getsockname()[1]}"


def router_session(
    listen: Sequence[str], *, connect: Sequence[str] = (), locks: Locks = OPEN
) -> zenoh.Session:
    """Open a Zenoh router in this process; the process ends only after it is closed.

    Args:
        listen: Endpoints to listen on, such as `tcp/127.0.0.1:7447`.
        connect: Other routers to link to; they may start later. This one is passed over.
        locks: Certificates, and Zenoh's settings laid over ours.

    Raises:
        TransientError: If an endpoint is taken.
        PermanentError: If an endpoint cannot be listened on here at all, or the locks cannot be
            used.
    """
    check_endpoints(listen)
    check_endpoints(connect)
    check_locks(locks, (*listen, *connect))
    others = [each for each in connect if not is_own(each, listen, machine=socket.gethostname())]
    config = _config("router", listen=listen, connect=others, locks=locks)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = ", ".join(listen)
        if "in use" in str(error):
            raise TransientError(
                f"cannot listen on {where}: the port is in use; stop what listens there, "
                "or choose another with --listen"
            ) from None
        raise PermanentError(f"cannot listen on {where}: {_reason(error)}") from None


def client_session(
    connect: Sequence[str],
    *,
    stop: Event | None = None,
    locks: Locks = OPEN,
    link_s: float | None = None,
) -> zenoh.Session:
    """Open a session through one of these routers; the process ends only after it is closed.

    A session outlives its router: Zenoh connects again and repeats every declaration.

    Args:
        connect: Endpoints of routers, any of which will do.
        stop: Wait for a router until this is set, as daemons do. None: fail at once.
        locks: Certificates, and Zenoh's settings laid over ours.
        link_s: Silence after which a router drops this session, seconds; None: Zenoh's 10 s.

    Raises:
        TransientError: If no router answers and `stop` is None, or `stop` was set.
        PermanentError: If an endpoint is malformed, or the locks cannot be used.
    """
    check_endpoints(connect)
    check_locks(locks, tuple(connect))
    config = _config("client", connect=connect, locks=locks)
    if link_s is not None:
        config.insert_json5("transport/link/tx/lease", str(round(1000 * link_s)))
    where = ", ".join(connect)
    waits = backoff_s(first_s=0.1, most_s=2.0)
    said = False
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if stop is None:
                tls = ", and does it know this certificate" if locks.is_set else ""
                raise TransientError(
                    f"no router at {where}: is `counterpoint run` or `counterpoint router` up{tls}?"
                ) from None
            if not said:
                log.warning("waiting for a router", connect=where, problem=_reason(error))
                said = True
        pause(stop, next(waits))


def is_connected(session: zenoh.Session) -> bool:
    """Return true if a router is connected; a put without one is lost without an error."""
    return bool(session.info.routers_zid())


def recoverable_publisher(session: zenoh.Session, key: str) -> zenoh.ext.AdvancedPublisher:
    """Declare a publisher that never stalls, and whose subscribers can fetch what they missed."""
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        encoding=RECORD,
        congestion_control=zenoh.CongestionControl.DROP,  # BLOCK stalls everyone behind one reader
        cache=zenoh.ext.CacheConfig(max_samples=CACHE_SAMPLES),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=None, sporadic_heartbeat=HEARTBEAT_S
        ),
        publisher_detection=True,
    )


def recoverable_subscriber(
    session: zenoh.Session,
    key: str,
    callback: Callable[[zenoh.Sample], Any],
    *,
    on_miss: Callable[[int], Any] | None = None,
) -> zenoh.ext.AdvancedSubscriber[None]:
    """Declare a subscriber that fetches what it missed.

    Args:
        session: On the bus.
        key: What to subscribe to.
        callback: Takes a sample; must only enqueue.
        on_miss: Called with the number of samples lost for good, each time some were.
    """
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        callback,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    if on_miss is not None:
        subscriber.sample_miss_listener(lambda miss: on_miss(miss.nb))  # lives as long as it does
    return subscriber


def _config(
    mode: str,
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    locks: Locks = OPEN,
) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    if mode == "router" and connect:
        config.insert_json5("connect/exit_on_failure", "false")
        config.insert_json5("connect/timeout_ms", "-1")  # tried again in the background for ever
    lay_locks(config, locks, listens=mode == "router")
    zenoh.init_log_from_env_or("error")
    return config


def check_endpoints(endpoints: Sequence[str]) -> None:
    """Refuse a malformed endpoint, before anything is started for it.

    Raises:
        PermanentError: If one is malformed.
    """
    for endpoint in endpoints:
        protocol, slash, address = endpoint.partition("/")
        _, colon, port = address.rpartition(":")
        number = port.split("#")[0].split("?")[0]
        is_port = number.isascii() and number.isdigit() and len(number) < 6 and int(number) < 65536
        if not (protocol and slash and colon and is_port):
            raise PermanentError(
                f"not an endpoint: {endpoint!r}; write it as tcp/host:port, for example "
                f"{DEFAULT_ENDPOINT}"
            )


def _reason(error: zenoh.ZError) -> str:
    """Keep the message of Zenoh, without the source lines of the machine it was built on."""
    return str(error).split(" at /", maxsplit=1)[0].strip()
