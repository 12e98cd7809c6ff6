"""A state folder as a data source, with or without a running service."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from schemas.runtime.stated_name import stated_name
from schemas.score import SceneScore
from schemas.transport.overlay_file import OverlayFile
from schemas.verdict import VerdictRow
from service.api.learned_top import learned_top
from service.api.messages import (
    ProposeRequest,
    RetryRequest,
    SceneRequest,
    SelectionRequest,
    SelectRequest,
    TopReply,
    TopRequest,
    VerdictsReply,
    checked_request,
    verdicts_reply,
)
from service.api.reader import no_such_scene, no_such_selection
from service.api.stored_overlays import key_of, open_stored_overlay, read_overlay
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.audit import AuditReply, AuditRequest, ExportedRequest
from service.curation.candidates import Proposal
from service.curation.compared_scenes import NamedSide
from service.curation.comparison import ComparedSide, CompareRequest, Comparison
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.mode_rows import ModesReply
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow, RatesRequest, rates, with_judged
from service.curation.selection import USUAL_TERMS, Selection, SelectionSummary, SelectionTerms
from service.curation.status import ParkedWork, Status
from service.curation.strategies.catalogue import strategy_of
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
    need_cause,
)
from service.errors import StateInUseError, UsageError
from service.settings.config import Settings
from service.settings.hidden_passwords import shown
from service.store.audit import Actor, acting
from service.store.ledger import Ledger, StoredScene
from service.store.opening import open_ledger_store, open_ledger_store_to_read, sole_service
from service.store.state import StateLock, endpoint_of_running


class StateReader:
    """Reads a state folder directly, with or without a running service."""

    def __init__(self, settings: Settings, *, now_s: float, opened: Ledger | None = None) -> None:
        """Keep the settings of the state, and the time for rates.

        Args:
            settings: Settings of the state.
            now_s: Time now, seconds since the Unix epoch.
            opened: Ledger to read instead of one that is opened for each question.
        """
        self._settings, self._now_s, self._opened = settings, now_s, opened

    @contextmanager
    def opened(self) -> Iterator["StateReader"]:
        """Yield a reader that opens the database once for all questions of a `with` block."""
        with self._ledger() as ledger:
            yield StateReader(self._settings, now_s=self._now_s, opened=ledger)

    @contextmanager
    def _ledger(self) -> Iterator[Ledger]:
        if self._opened is not None:
            yield self._opened
            return
        with closing(open_ledger_store_to_read(self._settings)) as store:
            yield Ledger(store, now_s=lambda: self._now_s)

    def top(self, most: int | None = None) -> list[RankedScene]:
        """Rank every current scene, best first, and return at most `most`; None: all."""
        asked = checked_request(TopRequest, most=most)
        with self._ledger() as ledger:
            return ledger.verdicts.with_verdicts(ledger.ranking(most=asked.most))

    def top_learned(self, most: int | None = None) -> TopReply:
        """Rank every current scene by what verdicts teach, where this is better, with its effect.

        Raises:
            UsageError: If the verdicts are too few, or of a single log.
        """
        asked = checked_request(TopRequest, most=most, learned=True)
        with self._ledger() as ledger:
            return learned_top(ledger, most=asked.most)

    @contextmanager
    def _ledger_to_write(self, *, what: str) -> Iterator[Ledger]:
        """Open the state for one change.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer.
        """
        with self._ledger():
            pass  # refuses a folder without a state, before anything is made in it
        try:
            with (
                StateLock(self._settings.state),
                sole_service(self._settings),
                closing(open_ledger_store(self._settings)) as store,
                acting(Actor(says=stated_name())),
            ):
                yield Ledger(store, now_s=lambda: self._now_s)
        except StateInUseError:
            endpoint = endpoint_of_running(self._settings.state) or "its endpoint"
            raise UsageError(
                f"a service runs on this state and alone may {what}: use --connect {endpoint}"
            ) from None

    def select(
        self,
        *,
        budget: int,
        name: str | None,
        scenes: Sequence[str] | None = None,
        terms: SelectionTerms = USUAL_TERMS,
    ) -> Selection:
        """Store scenes chosen by the terms, or these, as a named selection.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer and publisher.
        """
        asked = checked_request(SelectRequest, budget=budget, name=name, scenes=scenes, terms=terms)
        with self._ledger_to_write(what="select") as ledger:
            chosen = ledger.proposals.select(
                budget=asked.budget, name=asked.name, terms=asked.terms, wanted=asked.scenes
            )
            stored = ledger.selections.save(
                asked.name,
                budget=asked.budget,
                scenes=chosen,
                strategy=strategy_of(asked.scenes, asked.terms.strategy),
            )
            return ledger.verdicts.in_selection(stored)

    def propose(
        self, *, budget: int, name: str | None = None, terms: SelectionTerms = USUAL_TERMS
    ) -> Proposal:
        """Return the choice that `select` would store, with its reasons; nothing is stored."""
        asked = checked_request(ProposeRequest, budget=budget, name=name, terms=terms)
        with self._ledger() as ledger:
            return ledger.proposals.propose(budget=asked.budget, name=asked.name, terms=asked.terms)

    def selection(self, name: str) -> Selection:
        """Return the stored selection of this name."""
        asked = checked_request(SelectionRequest, name=name)
        with self._ledger() as ledger:
            found = ledger.selections.one(asked.name)
            if found is None:
                raise no_such_selection(name)
            return ledger.verdicts.in_selection(found)

    def selections(self) -> list[SelectionSummary]:
        """List every stored selection without its scenes, oldest first."""
        with self._ledger() as ledger:
            return ledger.selections.listed()

    def retry(
        self, log_ids: Sequence[str] | None = None, *, refused: bool = False
    ) -> list[ParkedWork]:
        """Mark parked work, of these logs or all, or all `refused` logs for the next run.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer.
            NothingFoundError: If one of these logs is not in the bucket.
        """
        asked = checked_request(RetryRequest, log_ids=log_ids, refused=refused)
        with self._ledger_to_write(what="retry") as ledger:
            return ledger.retry(asked.log_ids, refused=asked.refused)

    def exported(self, request: ExportedRequest) -> int:
        """Note an export in the audit log; return the number of its row.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer.
        """
        with self._ledger_to_write(what="note an export") as ledger:
            return ledger.audit_log.exported(request)

    def audit(self, request: AuditRequest) -> AuditReply:
        """Return a page of the audit log, latest first."""
        with self._ledger() as ledger:
            return AuditReply(rows=tuple(ledger.audit_log.page(request)))

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene."""
        return self._scene(scene_id).decoded()

    def overlay(self, scene_id: str) -> bytes:
        """Return the overlay of a current scene, encoded."""
        return read_overlay(self._settings.mining().artifacts, self._scene(scene_id))

    def record(self, scene_id: str) -> bytes:
        """Return the record of a scene as published; the last one if it is withdrawn."""
        return self._scene(scene_id, withdrawn=True).record

    def overlay_file(self, scene_id: str) -> OverlayFile:
        """Open the overlay of a current scene for reading single blocks."""
        scene = self._scene(scene_id)
        return open_stored_overlay(self._settings.mining().artifacts, scene)

    def overlay_place(self, scene_id: str) -> str:
        """Return the URL of a current scene's overlay."""
        key = key_of(self._scene(scene_id))
        return f"{shown(self._settings.mining().artifacts)}/{key}"

    def _scene(self, scene_id: str, *, withdrawn: bool = False) -> StoredScene:
        asked = checked_request(SceneRequest, scene_id=scene_id, withdrawn=withdrawn)
        with self._ledger() as ledger:
            stored = ledger.scene(asked.scene_id, withdrawn=asked.withdrawn)
        if stored is None:
            raise no_such_scene(scene_id)
        return stored

    def modes(self) -> ModesReply:
        """Group the strong tracks of the current scenes into failure modes."""
        with self._ledger() as ledger:
            return ledger.proposals.modes()

    def compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions."""
        with self._ledger() as ledger:
            return ledger.comparisons.compare(request)

    def compared_side(self, side: ComparedSide, *, name: str) -> NamedSide:
        """Read one side of a comparison, whose other side is of another state."""
        with self._ledger() as ledger:
            return ledger.comparisons.side(side, name=name)

    def rates(self, request: RatesRequest) -> list[RateRow]:
        """Count contradictions by group."""
        with self._ledger() as ledger:
            rows = rates(ledger.rate_sums(request), request.by)
            return with_judged(rows, request, ledger.verdicts.judged_scenes())

    def status(self) -> Status:
        """Return the progress of planning and mining."""
        with self._ledger() as ledger:
            return ledger.status()

    def scenes(self, request: ScenesRequest) -> ScenesReply:
        """Return a page of current scenes."""
        with self._ledger() as ledger:
            return ledger.listing(request)

    def judge(self, request: JudgeRequest) -> VerdictRow:
        """Store a verdict; the same request again, by its key, is stored once.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer and publisher;
                or if there is no such cause.
            NothingFoundError: If there was never such a scene.
        """
        need_cause(request.cause, self._settings.causes)
        with self._ledger_to_write(what="judge") as ledger:
            return ledger.verdicts.judge(request)

    def undo(self, request: UndoRequest) -> VerdictRow:
        """Undo a reviewer's last verdict; return the event of the undo.

        Raises:
            UsageError: If a service runs on this state, since it is the only writer and publisher.
            NothingFoundError: If there is no verdict to undo.
        """
        with self._ledger_to_write(what="undo") as ledger:
            return ledger.verdicts.undo(request)

    def verdicts(self, request: VerdictsRequest) -> VerdictsReply:
        """Return a page of verdicts, latest first."""
        with self._ledger() as ledger:
            return verdicts_reply(ledger.verdicts.page(request), most=request.most)

    def agreement(self, request: AgreementRequest) -> AgreementReply:
        """Return agreement, conflicts, pace and precision of the verdicts that count."""
        with self._ledger() as ledger:
            return ledger.verdicts.agreement(request)

    def activity(self, request: ActivityRequest) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        with self._ledger() as ledger:
            return ledger.activity(request)

    def choices(self) -> ChoicesReply:
        """Return the values that filters and verdicts choose from."""
        with self._ledger() as ledger:
            return ledger.choices(causes=self._settings.causes)
