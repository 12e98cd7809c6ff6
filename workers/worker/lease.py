"""A worker's side of a lease: claimed, renewed during work, finished or given back."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from threading import Event, Thread
from types import TracebackType
from typing import Final, Literal, Self

import structlog
import zenoh

from schemas.errors import CounterpointError, TransientError
from schemas.mining import MiningSettings
from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.ask import ask, ask_until
from schemas.transport.wire import Message, decode_reply, encode
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    FailRequest,
    Layers,
    MineLease,
    PlanLease,
    RenewRequest,
)

Verb = Literal["hello", "claim", "renew", "commit", "fail"]
"""Verbs of a worker's requests."""

log = structlog.get_logger(__name__)

RENEW_SHARE: Final = 1 / 3
"""Renewal interval as a share of a lease's term: two renewals may fail before it expires."""

ASK_S: Final = 10.0
RENEW_ASK_S: Final = 5.0
"""Timeouts of a request and of a renewal, seconds; a request is repeated, a renewal at its next
time."""


class LeaseLostError(CounterpointError):
    """The lease belongs to another worker now; its results are dropped without a message."""


class Leases:
    """Requests to the service, repeated until it answers, since it may be restarting."""

    def __init__(
        self, session: zenoh.Session, *, root: str, worker_id: str, is_named: bool = False
    ) -> None:
        """Keep the session and the worker's id.

        Args:
            session: On the bus.
            root: First part of every key.
            worker_id: Id of the worker.
            is_named: True if the keys of its requests name it, as rules of access control want.
        """
        self._session, self._root, self.worker_id = session, root, worker_id
        self._is_named = is_named

    def hello(self, *, stop: Event) -> MiningSettings:
        """Request the settings that all workers share."""
        return self._ask("hello", b"", MiningSettings, stop=stop)

    def claim(
        self, pipeline_version: str, *, layers: Layers | None = None, stop: Event
    ) -> ClaimReply:
        """Request a lease."""
        request = ClaimRequest(
            worker_id=self.worker_id, pipeline_version=pipeline_version, layers=layers
        )
        return self._ask("claim", encode(request), ClaimReply, stop=stop)

    def commit(self, request: CommitRequest, *, stop: Event) -> Answer:
        """Finish a lease; the answer comes after the service's transaction."""
        return self._ask("commit", encode(request), Answer, stop=stop)

    def fail(self, request: FailRequest, *, patience_s: float) -> None:
        """Give a lease back with its error; without an answer it expires by itself."""
        try:
            self._ask("fail", encode(request), Answer, stop=Event(), patience_s=patience_s)
        except TransientError as error:
            log.warning("failure not reported: the lease will expire", problem=str(error))

    def renew(self, lease_id: str) -> Answer:
        """Extend a lease, with a single request.

        Raises:
            CounterpointError: If there is no answer now, or not an expected one.
        """
        request = RenewRequest(worker_id=self.worker_id, lease_id=lease_id)
        answer = ask(self._session, self._key("renew"), encode(request), timeout_s=RENEW_ASK_S)
        return decode_reply(Answer, answer, to="renew")

    def _ask(
        self,
        verb: Verb,
        payload: bytes,
        kind: type[Message],
        *,
        stop: Event,
        patience_s: float = float("inf"),
    ) -> Message:
        answer = ask_until(
            self._session,
            self._key(verb),
            payload,
            stop=stop,
            patience_s=patience_s,
            timeout_s=min(ASK_S, patience_s),
        )
        return decode_reply(kind, answer, to=verb)

    def _key(self, verb: Verb) -> str:
        if self._is_named and verb != "hello":
            return keys.named_control(root=self._root, verb=verb, name=self.worker_id)
        return keys.control(root=self._root, verb=verb)


class LeaseKeeper(AbstractContextManager["LeaseKeeper"]):
    """Renews a lease in a thread of its own, and signals when work on it has become pointless.

    Attributes:
        drained: Set when the time to work on after a stop is over.
        over: Set then, and when the lease is lost: mining on would be in vain. A commit would not
            be: the service takes finished work under a lost lease, unless another was faster.
    """

    def __init__(
        self,
        leases: Leases,
        lease: PlanLease | MineLease,
        *,
        stop: Event,
        drain_s: float,
        on_unrenewed: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Keep a lease.

        Args:
            leases: Requests to the service.
            lease: The lease.
            stop: Set when the worker should end.
            drain_s: Time to work on the lease after that, seconds.
            on_unrenewed: Called for every renewal without an answer.
            clock: Monotonic seconds.
        """
        self.over, self.drained = Event(), Event()
        self._leases, self._lease, self._stop = leases, lease, stop
        self._drain_s, self._on_unrenewed, self._clock = drain_s, on_unrenewed, clock
        self._renew_s = lease.expires_s * RENEW_SHARE
        self._lost = ""
        self._done = Event()
        self._thread = Thread(target=self._keep, name="lease", daemon=True)

    def check(self) -> None:
        """Return only while the lease can still be finished.

        Raises:
            LeaseLostError: If the lease belongs to another worker.
            StoppedError: If the worker was stopped, and has drained long enough.
        """
        if self.drained.is_set():
            raise StoppedError(f"stopped after draining for {self._drain_s:g} s")
        if self.over.is_set():
            raise LeaseLostError(f"lease lost: {self._lost}")

    def __enter__(self) -> Self:
        """Start renewing."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop renewing."""
        self._done.set()
        self._thread.join()

    def _keep(self) -> None:
        renew_at_s = self._clock() + self._renew_s
        drain_until_s: float | None = None
        while not self._done.wait(0.1):
            now_s = self._clock()
            if self._stop.is_set():
                drain_until_s = drain_until_s or now_s + self._drain_s
                if now_s >= drain_until_s:
                    self.drained.set()
                    self.over.set()
            if now_s >= renew_at_s and not self.over.is_set():
                self._renew()
                renew_at_s = self._clock() + self._renew_s

    def _renew(self) -> None:
        try:
            answer = self._leases.renew(self._lease.lease_id)
        except CounterpointError as error:
            log.debug("lease not renewed", lease_id=self._lease.lease_id, problem=str(error))
            self._on_unrenewed()
            return
        if not answer.ok:
            self._lost = answer.problem or "it expired"
            self.over.set()
