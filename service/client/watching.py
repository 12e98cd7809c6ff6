"""Subscription to scored scenes: existing ones, then each new one, in order."""

import time
from collections.abc import Callable, Iterator, Sequence
from threading import Event
from typing import Final

import structlog

from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.bus import client_session
from schemas.transport.locks import OPEN, Locks
from service.client.merge import Holding, SceneEvent, SceneMerge, Wanted
from service.client.subscription import SceneSubscription

log = structlog.get_logger(__name__)

PAGE: Final = 500
"""Events of the history per request, at most 16 KB each; bounds the memory in use."""

IDLE_S: Final = 2.0
"""Silence after which the history is asked, seconds; a lost last scene leaves no gap."""

_LOOK_S: Final = 0.05
"""Poll interval for published scenes while there are none, seconds."""

_PAUSE_S: Final = 0.1
"""Shortest interval between two requests, however fast scenes are published, seconds."""

_AGAIN_S: Final = 0.5
"""The same interval after a number that the history did not know, seconds; it may be forged."""


def watch_scenes(
    connect: Sequence[str],
    *,
    root: str = keys.DEFAULT_ROOT,
    history: int | None = None,
    since: int | None = None,
    log: str = "*",
    vehicle: str | Sequence[str] = (),
    min_score: float = 0.0,
    stop: Event | None = None,
    wait: bool = True,
    on_service: Callable[[bool], None] | None = None,
    idle_s: float = IDLE_S,
    locks: Locks = OPEN,
) -> Iterator[SceneEvent]:
    """Yield scored scenes in the order of their numbers: existing ones, then each new one.

    A scene that is no longer current, or no longer matches the filters, is yielded as withdrawn.
    Published scenes are fetched from the history, which is also asked during silence; so a forged
    message is never yielded. Router and service may stop and return at any time. A subscriber that
    stores the number of the last event it handled, and passes it as `since` after a restart, misses
    no event and gets none twice.

    Events during an absence arrive merged, one per scene. A scene that was withdrawn and returned
    arrives again, with the same digest. One that was added and withdrawn arrives as withdrawn,
    although it was never yielded. A scene yielded before a restart, whose new record no longer
    matches, is not withdrawn: earlier processes are not known here.

    Memory: one page of the history, and 171 bytes for each scene that was yielded.

    Args:
        connect: Endpoints of routers.
        root: First part of every key.
        history: Number of past scenes, the newest; None: all of them.
        since: Only events after this number; not together with `history`.
        log: Pattern that must match the whole log id, `*` matches `/` too.
        vehicle: Only scenes of this vehicle, or of these.
        min_score: Only scenes with at least this score, 0 to 1.
        stop: Ends the iteration.
        wait: Wait for a router, if none answers at the start.
        on_service: Called with False when the service is gone and with True when it is back, once
            each; None: both are logged by structlog.
        idle_s: Silence after which the history is asked, seconds.
        locks: Certificates, where the router is reached by TLS.

    Raises:
        ValueError: If the arguments contradict each other.
        TransientError: If no router answers at the start, without `wait`.
        PermanentError: If the service refuses: `since` is beyond its last number, so that this is
            another ledger; or if its records cannot be read.
    """
    if not connect:
        raise ValueError("connect must name a router, such as tcp/127.0.0.1:7447")
    if history is not None and since is not None:
        raise ValueError("give history or since, not both: since gives all after that number")
    vehicles = frozenset((vehicle,) if isinstance(vehicle, str) else vehicle)
    wanted = Wanted(log=log, vehicles=vehicles, min_score=min_score)
    holding = Holding(wanted, resumed=bool(since))
    stop = stop or Event()

    def events() -> Iterator[SceneEvent]:
        try:
            session = client_session(connect, stop=stop if wait else None, locks=locks)
        except StoppedError:
            return
        with session, SceneSubscription(session, root=root) as subscription:
            merge = SceneMerge(subscription.history, page=PAGE, since=since or 0)
            presence = _Presence(on_service or _log_service, subscription)
            if history is not None:
                yield from filter(None, map(holding.news, _begin(merge, history, presence, stop)))
            following = _follow(merge, subscription, presence, stop, idle_s=idle_s)
            yield from filter(None, map(holding.news, following))

    return events()


class _Presence:
    """Presence of the service on the bus; reports each change."""

    def __init__(self, say: Callable[[bool], None], subscription: SceneSubscription) -> None:
        self._say, self._subscription = say, subscription
        self._was = True

    def look(self) -> bool:
        """Return true if the service is present."""
        there = self._subscription.service_is_there()
        if there != self._was:
            self._was = there
            self._say(there)
        return there


def _begin(
    merge: SceneMerge, newest: int, presence: _Presence, stop: Event
) -> Iterator[SceneEvent]:
    """Begin with the newest scenes, or from number 0 if a running service has none."""
    while not stop.is_set():
        there = presence.look()
        found = merge.begin(newest)
        if found is not None:
            yield from found
            return
        if there:
            return
        stop.wait(_AGAIN_S)


def _follow(
    merge: SceneMerge,
    subscription: SceneSubscription,
    presence: _Presence,
    stop: Event,
    *,
    idle_s: float,
) -> Iterator[SceneEvent]:
    """Yield every event after those that the merge has passed on, without end."""
    was_there = presence.look()
    ask_at_s = time.monotonic()
    asked_at_s, pause_s = ask_at_s - _AGAIN_S, _PAUSE_S
    while not stop.is_set():
        there = presence.look()
        if there and not was_there:
            ask_at_s = time.monotonic()
        was_there = there
        while (seq := subscription.published()) is not None:
            merge.hear(seq)
        heard = merge.is_behind
        if heard:
            ask_at_s = min(ask_at_s, asked_at_s + pause_s)
        if time.monotonic() < ask_at_s:
            stop.wait(_LOOK_S)
            continue
        complete_to = merge.complete_to
        yield from merge.catch_up()
        in_vain = heard and merge.complete_to == complete_to
        pause_s = _AGAIN_S if in_vain else _PAUSE_S
        asked_at_s = time.monotonic()
        ask_at_s = asked_at_s + idle_s


def _log_service(there: bool) -> None:
    if there:
        log.info("the service is back")
    else:
        log.warning("the service is gone; waiting for it")
