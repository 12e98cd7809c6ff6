"""Client of the service: requests by verb, and a subscription to scored scenes."""

import time
from collections.abc import Callable, Iterator, Sequence
from threading import Event
from typing import Any, Final

import structlog
from pydantic import BaseModel

from schemas.errors import PermanentError
from schemas.runtime.retry import StoppedError
from schemas.runtime.stated_name import stated_name
from schemas.score import SceneScore
from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask_until
from schemas.transport.bus import client_session
from schemas.transport.locks import OPEN, Locks
from schemas.transport.overlay_codec import overlay_file_of
from schemas.transport.overlay_file import OverlayFile
from schemas.transport.wire import decode, encode
from schemas.verdict import VerdictRow
from service.api.messages import (
    ProposeRequest,
    RatesReply,
    RetryReply,
    RetryRequest,
    SceneRequest,
    SelectionRequest,
    SelectionsReply,
    SelectRequest,
    TopReply,
    TopRequest,
    VerdictsReply,
    checked_request,
)
from service.api.verbs import OF_PEOPLE
from service.client.earlier_service import refusal_to_learn
from service.client.merge import Holding, SceneEvent, SceneMerge, Wanted
from service.client.subscription import SceneSubscription
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.audit import AuditedReply, AuditReply, AuditRequest, ExportedRequest
from service.curation.candidates import Proposal
from service.curation.comparison import CompareRequest, Comparison
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.mode_rows import ModesReply
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow, RatesRequest
from service.curation.selection import (
    USUAL_TERMS,
    Selection,
    SelectionSummary,
    SelectionTerms,
)
from service.curation.status import ParkedWork, Status
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)

log = structlog.get_logger(__name__)

PATIENCE_S: Final = 3.0
"""Time that a request waits for a service that is just starting, seconds."""

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


class ControlClient:
    """Sends requests to a running service.

    Each request opens a session of its own, which takes milliseconds.

    Every method raises `TransientError` when there is no router or no service, and `PermanentError`
    when the service refuses.
    """

    def __init__(self, connect: Sequence[str], *, root: str, locks: Locks = OPEN) -> None:
        """Keep the endpoints of routers, the first part of every key, and the certificates."""
        self._connect, self._root, self._locks = tuple(connect), root, locks

    def top(self, most: int | None = None) -> list[RankedScene]:
        """Rank every current scene, best first, and return at most `most`; None: all."""
        return list(decode(TopReply, self._ask_with_verdicts("top", TopRequest, most=most)).scenes)

    def top_learned(self, most: int | None = None) -> TopReply:
        """Rank every current scene by what verdicts teach, where this ranks better; its effect."""
        asked = checked_request(TopRequest, most=most, learned=True)
        try:
            return decode(TopReply, self._ask("top", asked))
        except PermanentError as error:
            raise refusal_to_learn(error, self._connect) from None

    def select(
        self,
        *,
        budget: int,
        name: str | None = None,
        scenes: Sequence[str] | None = None,
        terms: SelectionTerms = USUAL_TERMS,
    ) -> Selection:
        """Store scenes chosen by the terms, or these, as a named selection, and publish it."""
        asked = {"budget": budget, "name": name, "scenes": scenes, "terms": terms}
        return decode(Selection, self._ask_with_verdicts("select", SelectRequest, **asked))

    def propose(
        self, *, budget: int, name: str | None = None, terms: SelectionTerms = USUAL_TERMS
    ) -> Proposal:
        """Return the choice that `select` would store, with its reasons; nothing is stored."""
        asked = checked_request(ProposeRequest, budget=budget, name=name, terms=terms)
        return decode(Proposal, self._ask("propose", asked))

    def selection(self, name: str) -> Selection:
        """Return the stored selection of this name."""
        return decode(Selection, self._ask_with_verdicts("selection", SelectionRequest, name=name))

    def selections(self) -> list[SelectionSummary]:
        """List every stored selection without its scenes, oldest first."""
        return list(decode(SelectionsReply, self._ask("selections")).selections)

    def status(self) -> Status:
        """Return the progress of planning and mining."""
        return decode(Status, self._ask("status"))

    def retry(self, log_ids: Sequence[str] | None = None) -> list[ParkedWork]:
        """Retry parked work, of these logs or all; return what was parked."""
        wanted = None if log_ids is None else tuple(log_ids)
        return list(
            decode(
                RetryReply, self._ask("retry", checked_request(RetryRequest, log_ids=wanted))
            ).retried
        )

    def exported(self, request: ExportedRequest) -> int:
        """Note an export in the audit log; return the number of its row."""
        return decode(AuditedReply, self._ask("exported", request)).ordinal

    def audit(self, request: AuditRequest) -> AuditReply:
        """Return a page of the audit log, latest first."""
        return decode(AuditReply, self._ask("audit", request))

    def modes(self) -> ModesReply:
        """Group the strong tracks of the current scenes into failure modes."""
        return decode(ModesReply, self._ask("modes"))

    def compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions."""
        return decode(Comparison, self._ask("compare", request))

    def rates(self, request: RatesRequest) -> list[RateRow]:
        """Return the rate of contradictions by group."""
        asked = request.model_dump(exclude={"verdicts"})
        reply = self._ask_with_verdicts("rates", RatesRequest, **asked)
        return list(decode(RatesReply, reply).rows)

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene."""
        return decode(
            SceneScore, self._ask("scene", checked_request(SceneRequest, scene_id=scene_id))
        )

    def record(self, scene_id: str) -> bytes:
        """Return the record of a scene as published; the last one if it is withdrawn."""
        asked = checked_request(SceneRequest, scene_id=scene_id, withdrawn=True)
        return self._ask("scene", asked)

    def overlay(self, scene_id: str) -> bytes:
        """Return the overlay of a current scene, encoded."""
        return self._ask("overlay", checked_request(SceneRequest, scene_id=scene_id))

    def overlay_place(self, scene_id: str) -> str:
        """Return the name of the source of a scene's overlay, for messages."""
        return f"{scene_id}, from the service at {','.join(self._connect)}"

    def overlay_file(self, scene_id: str) -> OverlayFile:
        """Open the overlay of a current scene for reading single blocks."""
        return overlay_file_of(self.overlay(scene_id), where=self.overlay_place(scene_id))

    def scenes(self, request: ScenesRequest) -> ScenesReply:
        """Return a page of current scenes."""
        return decode(ScenesReply, self._ask("scenes", request))

    def judge(self, request: JudgeRequest) -> VerdictRow:
        """Store a verdict; the same request again, by its key, is stored once."""
        return decode(VerdictRow, self._ask("judge", request))

    def undo(self, request: UndoRequest) -> VerdictRow:
        """Undo a reviewer's last verdict; return the event of the undo."""
        return decode(VerdictRow, self._ask("undo", request))

    def verdicts(self, request: VerdictsRequest) -> VerdictsReply:
        """Return a page of verdicts, latest first."""
        return decode(VerdictsReply, self._ask("verdicts", request))

    def agreement(self, request: AgreementRequest) -> AgreementReply:
        """Return agreement, conflicts, pace and precision of the verdicts that count."""
        return decode(AgreementReply, self._ask("agreement", request))

    def activity(self, request: ActivityRequest) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        return decode(ActivityReply, self._ask("activity", request))

    def choices(self) -> ChoicesReply:
        """Return the values that filters and verdicts choose from."""
        return decode(ChoicesReply, self._ask("choices"))

    def _ask_with_verdicts(self, verb: str, kind: type[BaseModel], /, **fields: Any) -> bytes:
        """Request rows with their verdicts; without, from a service that knows none."""
        try:
            return self._ask(verb, checked_request(kind, **fields, verdicts=True))
        except PermanentError as error:
            if "verdicts: " not in str(error):
                raise
            return self._ask(verb, checked_request(kind, **fields))

    def _ask(self, verb: str, request: BaseModel | None = None) -> bytes:
        is_audited = verb in OF_PEOPLE
        key = keys.control(root=self._root, verb=verb)
        if is_audited and self._locks.name:
            key = keys.named_control(root=self._root, verb=verb, name=self._locks.name)
        with client_session(self._connect, locks=self._locks) as session:
            try:
                return ask_until(
                    session,
                    key,
                    encode(request) if request is not None else b"",
                    stop=Event(),
                    patience_s=PATIENCE_S,
                    says=stated_name() if is_audited else "",
                )
            except UnansweredError as error:
                if not self._locks.is_set:
                    raise
                raise UnansweredError(
                    f"{error} Or the certificate of {self._locks.name} may not ask it"
                ) from None


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
