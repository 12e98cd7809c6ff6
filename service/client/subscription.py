"""Subscription of one client: published scenes, their history, and the presence of the service.

No callbacks are used. A callback keeps its process alive for ever if its session is not closed, and
a loop over scenes that ends with an exception closes nothing. Published samples go into a ring that
drops its oldest, and the history supplies those, so memory is bounded.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Final, Self

import structlog
import zenoh
from pydantic import ValidationError

from schemas.canonical import sha256
from schemas.errors import PermanentError
from schemas.events import SceneNumber
from schemas.problem import Problem
from schemas.score import SceneScore
from schemas.transport import keys
from schemas.transport.ask import PROBLEM
from schemas.transport.bus import is_connected
from schemas.transport.wire import decode, first_problem
from service.client.merge import SceneEvent

log = structlog.get_logger(__name__)

RING: Final = 256
"""Samples kept between two polls, at most 16 KB each."""

PAGE_TIMEOUT_S: Final = 5.0
"""Timeout of one page of the history, which normally takes milliseconds, seconds."""


class SceneSubscription:
    """Scenes of one root, through one session; usable within the `with` block.

    Attributes:
        dropped: Messages that were no scenes of a service, and were ignored.
    """

    def __init__(self, session: zenoh.Session, *, root: str) -> None:
        """Keep the session, which must outlive the block, and the first part of every key."""
        self._session, self._root = session, root
        self._services: set[str] = set()
        self._open = ExitStack()
        self.dropped = 0

    def __enter__(self) -> Self:
        """Subscribe before any request, so that no event is missed in between."""
        services = keys.all_live(root=self._root, role="service")
        with ExitStack() as opening:
            self._published = opening.enter_context(
                self._session.declare_subscriber(
                    keys.all_scenes(root=self._root), zenoh.handlers.RingChannel(RING)
                )
            )
            self._lives = opening.enter_context(
                self._session.liveliness().declare_subscriber(
                    services, zenoh.handlers.RingChannel(RING), history=True
                )
            )
            # The subscription tells of it too, but somewhat later.
            for reply in self._session.liveliness().get(services, timeout=PAGE_TIMEOUT_S):
                if reply.ok is not None:
                    self._services.add(str(reply.ok.key_expr))
            self._open = opening.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Unsubscribe."""
        self._open.close()

    def service_is_there(self) -> bool:
        """Return true if a service is on the bus, by its liveliness token."""
        while (sample := self._lives.try_recv()) is not None:
            if sample.kind == zenoh.SampleKind.PUT:
                self._services.add(str(sample.key_expr))
            else:
                self._services.discard(str(sample.key_expr))
        return bool(self._services)

    def published(self) -> int | None:
        """Return the number of the next published event, if one is waiting.

        Anyone can publish, so a number only means that the history should be asked.
        """
        while (sample := self._published.try_recv()) is not None:
            try:
                keys.scene_id_of(str(sample.key_expr), root=self._root)
                return _seq(sample)
            except (ValidationError, ValueError) as error:
                self._drop(sample, error)
        return None

    def history(self, asked: Mapping[str, int]) -> Sequence[SceneEvent]:
        """Request a page of the history; a truncated reply is complete up to its last event.

        The reply is read whole before it is processed, since waiting replies block the session.

        Args:
            asked: Parameters of the request.

        Raises:
            PermanentError: If the service refuses, or a reply cannot be read.
        """
        # Measured: where a session has a subscriber for the same wildcard, a question without a
        # router is not answered empty at once, as others are, but only when its time is up.
        if not is_connected(self._session):
            return ()
        page: list[SceneEvent] = []
        for reply in self._session.get(
            f"{keys.all_scenes(root=self._root)}?{_parameters(asked)}",
            timeout=PAGE_TIMEOUT_S,
            consolidation=zenoh.ConsolidationMode.NONE,  # any other merges replies
        ):
            if reply.ok is None:
                _raise_refusal(reply.err)
                return page
            try:
                page.append(self._event(reply.ok))
            except (ValidationError, ValueError) as error:
                self._drop(reply.ok, error)
        return page

    def _event(self, sample: zenoh.Sample) -> SceneEvent:
        """Decode an event of the history.

        Raises:
            PermanentError: If its record is of a later version.
            ValueError: If it is no event.
        """
        seq = _seq(sample)
        scene_id = keys.scene_id_of(str(sample.key_expr), root=self._root)
        if sample.kind == zenoh.SampleKind.DELETE:
            return SceneEvent(seq, scene_id)
        record = sample.payload.to_bytes()
        try:
            score = decode(SceneScore, record)
        except ValidationError as error:
            if _is_of_a_later_version(error):
                raise PermanentError(
                    f"cannot read a scene of the history: {first_problem(error)} "
                    f"({sample.key_expr}); is this program older than the service?"
                ) from None
            self._drop(sample, error)
            return SceneEvent(seq, scene_id, record, unreadable=True)
        return SceneEvent(seq, scene_id, record, sha256(record), score)

    def _drop(self, sample: zenoh.Sample, error: ValueError) -> None:
        """Count a message that is no scene; log the first one."""
        self.dropped += 1
        if self.dropped == 1:
            said = first_problem(error) if isinstance(error, ValidationError) else str(error)
            log.warning(
                "message is not a scene; it is ignored, and further ones are not logged",
                key=str(sample.key_expr)[:200],
                problem=said[:200],
            )


def _parameters(asked: Mapping[str, int]) -> str:
    return ";".join(f"{name}={number}" for name, number in asked.items())


def _seq(sample: zenoh.Sample) -> int:
    attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
    return decode(SceneNumber, attachment).seq


def _is_of_a_later_version(error: ValidationError) -> bool:
    """Return true if a record has fields, or a version, that this program does not know."""
    return any(
        cause["type"] == "extra_forbidden" or cause["loc"] == ("schema_version",)
        for cause in error.errors(include_url=False, include_input=False)
    )


def _raise_refusal(error: zenoh.ReplyError | None) -> None:
    """Raise a permanent refusal of the service; anything else, such as a timeout, may pass."""
    if error is None or error.encoding != PROBLEM:
        return
    try:
        problem = decode(Problem, error.payload.to_bytes())
    except ValidationError:
        return
    if not problem.transient:
        raise PermanentError(problem.problem)
