"""Delivery of webhooks: one thread per receiver, at least once, in the order of the numbers.

A delivery takes nothing from mining but one short transaction. A receiver that hangs or fails
delays only its own events; they wait in the ledger.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from email.message import Message
from hashlib import sha256
from http.client import HTTPException
from typing import IO, Final, Literal
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

import structlog

from schemas.errors import CounterpointError
from schemas.runtime.retry import backoff_s
from service.background.webhook_terms import WebhookTerms
from service.curation.webhooks import WebhookEvent, encoded, signature
from service.store.webhooks import PAGE, SOURCES, Webhooks

log = structlog.get_logger(__name__)

LOOK_EVERY_S: Final = 1.0
"""Interval at which the ledger is asked for new events, seconds."""

TIMEOUT_S: Final = 10.0
"""Time in which a receiver has to answer, seconds."""

FIRST_WAIT_S: Final = 1.0
MOST_WAIT_S: Final = 600.0
"""Shortest and longest wait after a failed delivery, seconds; it doubles in between."""

END_S: Final = 2.0
"""Time for attempts that are under way at the end, seconds; a receiver that hangs is left."""

Outcome = Literal["delivered", "failed"]
"""Outcome of one attempt."""

Post = Callable[[str, bytes, Mapping[str, str]], str]
"""Sends a body to a URL with headers; returns what failed, empty: it was taken."""


@dataclass(slots=True)
class _Receiver:
    """One receiver.

    Attributes:
        url: Its URL.
        name: Its host, for messages: the rest of a URL may be secret.
        key: Digest of the URL, by which the ledger knows it.
        failing_since_s: Monotonic time of the first failure of the event that waits; None: none.
    """

    url: str
    name: str = field(init=False)
    key: str = field(init=False)
    failing_since_s: float | None = None

    def __post_init__(self) -> None:
        self.name = urlsplit(self.url).netloc.rpartition("@")[2]
        self.key = sha256(self.url.encode()).hexdigest()[:32]


class WebhookDelivery:
    """Delivers events to every receiver within a `with` block."""

    def __init__(
        self,
        webhooks: Webhooks,
        terms: WebhookTerms,
        *,
        now_s: Callable[[], float],
        on_outcome: Callable[[Outcome], None] = lambda _: None,
        post: Post | None = None,
        first_wait_s: float = FIRST_WAIT_S,
    ) -> None:
        """Keep the parts; nothing is sent before the block is entered.

        Args:
            webhooks: Events, and how far each receiver is.
            terms: Receivers, and what they are sent.
            now_s: Seconds since the Unix epoch.
            on_outcome: Is called after each attempt.
            post: Sends a body; None: over HTTP.
            first_wait_s: Wait after the first failure, seconds.
        """
        self._webhooks, self._terms, self._now_s = webhooks, terms, now_s
        self._on_outcome, self._post = on_outcome, post or post_over_http
        self._first_wait_s, self._stop = first_wait_s, threading.Event()
        self._receivers = [_Receiver(url) for url in terms.urls]
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> "WebhookDelivery":
        """Note where new receivers begin, and start to deliver."""
        for receiver in self._receivers:
            self._webhooks.begin(receiver.key)
            thread = threading.Thread(
                target=self._follow, args=(receiver,), name="webhook", daemon=True
            )
            thread.start()
            self._threads.append(thread)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop; an attempt that is under way is repeated after the next start."""
        self._stop.set()
        end_s = time.monotonic() + END_S
        for thread in self._threads:
            thread.join(max(0.0, end_s - time.monotonic()))

    @property
    def late_s(self) -> float:
        """Time for which the receiver in the worst state has failed, seconds; 0: none fails."""
        since = [each.failing_since_s for each in self._receivers]
        now_s = time.monotonic()
        return max((now_s - each for each in since if each is not None), default=0.0)

    def _follow(self, receiver: _Receiver) -> None:
        """Deliver until the block ends."""
        waits = self._waits()
        while not self._stop.is_set():
            try:
                problem = self._deliver_some(receiver)
            except CounterpointError as error:  # the ledger; it is asked again
                problem = str(error)
            except Exception as error:
                log.error("webhooks: a fault of the program", to=receiver.name, exc_info=error)
                problem = type(error).__name__
            if not problem:
                waits = self._waits()
                self._stop.wait(LOOK_EVERY_S)
                continue
            if receiver.failing_since_s is None:
                receiver.failing_since_s = time.monotonic()
                said = "a webhook is not delivered, and tried again"
                log.warning(said, to=receiver.name, problem=problem)
            self._stop.wait(next(waits))

    def _waits(self) -> Iterator[float]:
        return backoff_s(first_s=self._first_wait_s, most_s=MOST_WAIT_S)

    def _deliver_some(self, receiver: _Receiver) -> str:
        """Deliver what is due, in order; return what failed."""
        cursors = self._webhooks.cursors(receiver.key)
        for source in SOURCES:
            number = cursors[source]
            while not self._stop.is_set():
                due = self._webhooks.after(source, number, min_score=self._terms.min_score)
                for each in due:
                    if each.event is None or each.event.type not in self._terms.events:
                        continue
                    if problem := self._attempt(receiver, each.event):
                        return problem
                    number = each.number
                    self._webhooks.delivered(receiver.key, source, number)
                    if self._stop.is_set():
                        return ""
                if due and due[-1].number > number:
                    number = due[-1].number
                    self._webhooks.delivered(receiver.key, source, number)
                if len(due) < PAGE:
                    break
        return ""

    def _attempt(self, receiver: _Receiver, event: WebhookEvent) -> str:
        """Send one event once; return what failed."""
        body, timestamp_s = encoded(event), int(self._now_s())
        signed = signature(
            self._terms.secret, event_id=event.id, timestamp_s=timestamp_s, body=body
        )
        headers = {
            "content-type": "application/json",
            "user-agent": "counterpoint",
            "webhook-id": event.id,
            "webhook-timestamp": str(timestamp_s),
            "webhook-signature": signed,
        }
        problem = self._post(receiver.url, body, headers)
        self._on_outcome("failed" if problem else "delivered")
        if not problem and receiver.failing_since_s is not None:
            receiver.failing_since_s = None
            log.info("webhooks are delivered again", to=receiver.name)
        return problem


class _NoRedirect(HTTPRedirectHandler):
    """Follows no redirection: a signed event must not reach another host."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: Message, newurl: str
    ) -> None:
        return None


_OPENER: Final = build_opener(_NoRedirect)


def post_over_http(url: str, body: bytes, headers: Mapping[str, str]) -> str:
    """Send a body; return what failed, empty where the status is 2xx."""
    request = Request(url, data=body, headers=dict(headers), method="POST")  # noqa: S310 - HTTP
    try:
        with _OPENER.open(request, timeout=TIMEOUT_S):
            return ""
    except HTTPError as error:
        with error:
            return f"the receiver answers with status {error.code}"
    except (OSError, HTTPException, ValueError) as error:
        return f"the receiver does not answer: {getattr(error, 'reason', None) or error}"[:300]
