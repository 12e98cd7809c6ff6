"""Data source of the reading verbs, by one protocol: a running service, or a state folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.overlay_codec import decode_overlay
from schemas.transport.overlay_file import OverlayFile
from schemas.verdict import VerdictRow
from service.api.messages import TopReply, VerdictsReply
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.audit import AuditReply, AuditRequest, ExportedRequest
from service.curation.candidates import Proposal
from service.curation.comparison import CompareRequest, Comparison
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.mode_rows import ModesReply
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow, RatesRequest
from service.curation.selection import USUAL_TERMS, Selection, SelectionSummary, SelectionTerms
from service.curation.status import ParkedWork, Status
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)
from service.errors import NothingFoundError
from service.settings.config import Settings
from service.store.state import endpoint_of_running


class Reader(Protocol):
    """Interface of the verbs that read results: `top`, `select`, `selection`, `show` and more."""

    def top(self, most: int | None = None) -> list[RankedScene]:
        """Rank every current scene, best first."""
        ...

    def top_learned(self, most: int | None = None) -> TopReply:
        """Rank every current scene by what verdicts teach, where this is better, with its effect.

        Raises:
            UsageError: If the verdicts are too few, or of a single log; a `PermanentError` over
                the bus.
        """
        ...

    def select(
        self,
        *,
        budget: int,
        name: str | None,
        scenes: Sequence[str] | None = None,
        terms: SelectionTerms = USUAL_TERMS,
    ) -> Selection:
        """Store scenes chosen by the terms, or these, as a named selection."""
        ...

    def propose(
        self, *, budget: int, name: str | None = None, terms: SelectionTerms = USUAL_TERMS
    ) -> Proposal:
        """Return the choice that `select` would store, with its reasons; nothing is stored."""
        ...

    def selection(self, name: str) -> Selection:
        """Return the stored selection of this name."""
        ...

    def selections(self) -> list[SelectionSummary]:
        """List every stored selection without its scenes, oldest first."""
        ...

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene."""
        ...

    def record(self, scene_id: str) -> bytes:
        """Return the record of a scene as published; the last one if it is withdrawn."""
        ...

    def overlay(self, scene_id: str) -> bytes:
        """Return the overlay of a current scene, encoded."""
        ...

    def overlay_file(self, scene_id: str) -> OverlayFile:
        """Open the overlay of a current scene for reading single blocks."""
        ...

    def overlay_place(self, scene_id: str) -> str:
        """Return the URL or name of the source of a scene's overlay, for messages."""
        ...

    def modes(self) -> ModesReply:
        """Group the strong tracks of the current scenes into failure modes."""
        ...

    def compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions."""
        ...

    def rates(self, request: RatesRequest) -> list[RateRow]:
        """Count contradictions by group."""
        ...

    def status(self) -> Status:
        """Return the progress of planning and mining."""
        ...

    def retry(
        self, log_ids: Sequence[str] | None = None, *, refused: bool = False
    ) -> list[ParkedWork]:
        """Retry parked work, of these logs or all, or all `refused` logs; return what it was."""
        ...

    def exported(self, request: ExportedRequest) -> int:
        """Note an export in the audit log; return the number of its row."""
        ...

    def audit(self, request: AuditRequest) -> AuditReply:
        """Return a page of the audit log, latest first."""
        ...

    def scenes(self, request: ScenesRequest) -> ScenesReply:
        """Return a page of current scenes."""
        ...

    def judge(self, request: JudgeRequest) -> VerdictRow:
        """Store a verdict; the same request again, by its key, is stored once."""
        ...

    def undo(self, request: UndoRequest) -> VerdictRow:
        """Undo a reviewer's last verdict; return the event of the undo."""
        ...

    def verdicts(self, request: VerdictsRequest) -> VerdictsReply:
        """Return a page of verdicts, latest first."""
        ...

    def agreement(self, request: AgreementRequest) -> AgreementReply:
        """Return agreement, conflicts, pace and precision of the verdicts that count."""
        ...

    def activity(self, request: ActivityRequest) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        ...

    def choices(self) -> ChoicesReply:
        """Return the values that filters and verdicts choose from."""
        ...


def overlay_of(source: Reader, scene_id: str) -> Overlay:
    """Read and decode the overlay of a current scene.

    Raises:
        NothingFoundError: If there is none.
        PackUnreadableError: If it is damaged or of another scene; the message names its URL.
    """
    payload = source.overlay(scene_id)
    return decode_overlay(payload, scene_id=scene_id, where=source.overlay_place(scene_id))


def no_such_scene(scene_id: str) -> NothingFoundError:
    """Return the error for an id of no current scene."""
    return NothingFoundError(f"no current scene {scene_id!r}; `counterpoint top` lists them")


def no_such_selection(name: str) -> NothingFoundError:
    """Return the error for a name of no stored selection."""
    return NothingFoundError(f"no selection {name!r}; `counterpoint selection list` lists them")


def choose_endpoint(settings: Settings) -> str:
    """Return the endpoint of the service: `--connect`, else that of the state folder.

    Raises:
        NothingFoundError: If no service runs on the state folder.
    """
    if settings.connect:
        return settings.connect
    endpoint = endpoint_of_running(Path(settings.state))
    if not endpoint:
        raise NothingFoundError(
            f"no service runs on {settings.state}: start `counterpoint run`, or give --connect"
        )
    return endpoint
