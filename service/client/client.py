"""Client of the service: a request for each verb."""

from collections.abc import Sequence
from threading import Event
from typing import Any, Final

from pydantic import BaseModel

from schemas.errors import PermanentError
from schemas.runtime.stated_name import stated_name
from schemas.score import SceneScore
from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask_until
from schemas.transport.bus import client_session
from schemas.transport.locks import OPEN, Locks
from schemas.transport.overlay_codec import overlay_file_of
from schemas.transport.overlay_file import OverlayFile
from schemas.transport.wire import Message, decode_reply, encode
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

PATIENCE_S: Final = 3.0
"""Time that a request waits for a service that is just starting, seconds."""


class ControlClient:
    """Sends requests to a running service.

    Each request opens a session of its own, which takes milliseconds.

    Every method raises `TransientError` when there is no router or no service, and `PermanentError`
    when the service refuses, or its answer cannot be read.
    """

    def __init__(self, connect: Sequence[str], *, root: str, locks: Locks = OPEN) -> None:
        """Keep the endpoints of routers, the first part of every key, and the certificates."""
        self._connect, self._root, self._locks = tuple(connect), root, locks

    def top(self, most: int | None = None) -> list[RankedScene]:
        """Rank every current scene, best first, and return at most `most`; None: all."""
        return list(self._answer_with_verdicts(TopReply, "top", TopRequest, most=most).scenes)

    def top_learned(self, most: int | None = None) -> TopReply:
        """Rank every current scene by what verdicts teach, where this ranks better; its effect."""
        asked = checked_request(TopRequest, most=most, learned=True)
        try:
            return self._answer(TopReply, "top", asked)
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
        return self._answer_with_verdicts(Selection, "select", SelectRequest, **asked)

    def propose(
        self, *, budget: int, name: str | None = None, terms: SelectionTerms = USUAL_TERMS
    ) -> Proposal:
        """Return the choice that `select` would store, with its reasons; nothing is stored."""
        asked = checked_request(ProposeRequest, budget=budget, name=name, terms=terms)
        return self._answer(Proposal, "propose", asked)

    def selection(self, name: str) -> Selection:
        """Return the stored selection of this name."""
        return self._answer_with_verdicts(Selection, "selection", SelectionRequest, name=name)

    def selections(self) -> list[SelectionSummary]:
        """List every stored selection without its scenes, oldest first."""
        return list(self._answer(SelectionsReply, "selections").selections)

    def status(self) -> Status:
        """Return the progress of planning and mining."""
        return self._answer(Status, "status")

    def retry(
        self, log_ids: Sequence[str] | None = None, *, refused: bool = False
    ) -> list[ParkedWork]:
        """Retry parked work, of these logs or all, or all `refused` logs; return what it was."""
        wanted = None if log_ids is None else tuple(log_ids)
        request = checked_request(RetryRequest, log_ids=wanted, refused=refused)
        return list(self._answer(RetryReply, "retry", request).retried)

    def exported(self, request: ExportedRequest) -> int:
        """Note an export in the audit log; return the number of its row."""
        return self._answer(AuditedReply, "exported", request).ordinal

    def audit(self, request: AuditRequest) -> AuditReply:
        """Return a page of the audit log, latest first."""
        return self._answer(AuditReply, "audit", request)

    def modes(self) -> ModesReply:
        """Group the strong tracks of the current scenes into failure modes."""
        return self._answer(ModesReply, "modes")

    def compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions."""
        return self._answer(Comparison, "compare", request)

    def rates(self, request: RatesRequest) -> list[RateRow]:
        """Return the rate of contradictions by group."""
        asked = request.model_dump(exclude={"verdicts"})
        return list(self._answer_with_verdicts(RatesReply, "rates", RatesRequest, **asked).rows)

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene."""
        return self._answer(SceneScore, "scene", checked_request(SceneRequest, scene_id=scene_id))

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
        return self._answer(ScenesReply, "scenes", request)

    def judge(self, request: JudgeRequest) -> VerdictRow:
        """Store a verdict; the same request again, by its key, is stored once."""
        return self._answer(VerdictRow, "judge", request)

    def undo(self, request: UndoRequest) -> VerdictRow:
        """Undo a reviewer's last verdict; return the event of the undo."""
        return self._answer(VerdictRow, "undo", request)

    def verdicts(self, request: VerdictsRequest) -> VerdictsReply:
        """Return a page of verdicts, latest first."""
        return self._answer(VerdictsReply, "verdicts", request)

    def agreement(self, request: AgreementRequest) -> AgreementReply:
        """Return agreement, conflicts, pace and precision of the verdicts that count."""
        return self._answer(AgreementReply, "agreement", request)

    def activity(self, request: ActivityRequest) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        return self._answer(ActivityReply, "activity", request)

    def choices(self) -> ChoicesReply:
        """Return the values that filters and verdicts choose from."""
        return self._answer(ChoicesReply, "choices")

    def _answer_with_verdicts(
        self, reply: type[Message], verb: str, kind: type[BaseModel], /, **fields: Any
    ) -> Message:
        return decode_reply(reply, self._ask_with_verdicts(verb, kind, **fields), to=verb)

    def _answer(self, kind: type[Message], verb: str, request: BaseModel | None = None) -> Message:
        return decode_reply(kind, self._ask(verb, request), to=verb)

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
