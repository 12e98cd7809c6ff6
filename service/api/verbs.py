"""The verbs of the bus: each with its request, its reply and its limits."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pydantic import BaseModel

from schemas.backlog import WorkBacklog
from schemas.bounds import MAX_COMMIT_BYTES, MAX_QUESTION_BYTES
from schemas.mining import MiningSettings
from schemas.score import SceneScore
from schemas.verdict import VerdictRow
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    FailRequest,
    RenewRequest,
)
from service.api.messages import (
    AboutReply,
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
)
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.audit import AuditedReply, AuditReply, AuditRequest, ExportedRequest
from service.curation.candidates import Proposal
from service.curation.comparison import CompareRequest, Comparison
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.mode_rows import ModesReply
from service.curation.rates import RatesRequest
from service.curation.selection import Selection
from service.curation.status import Status
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)


@dataclass(frozen=True, slots=True)
class VerbType:
    """Types and limits of one verb.

    Attributes:
        request: Message that it takes; None: nothing, and a payload is passed over.
        reply: Message that it answers; None: the bytes of an overlay.
        writes: It is answered only after a transaction.
        reads_all: It reads the whole ledger. One is answered at a time, and after it the verb
            rests as long as the answer took: however many ask, workers find the processor free.
        most_bytes: A longer payload is refused before it is read.
    """

    request: type[BaseModel] | None
    reply: type[BaseModel] | None
    writes: bool = False
    reads_all: bool = False
    most_bytes: int = MAX_QUESTION_BYTES


VERBS: Final[Mapping[str, VerbType]] = MappingProxyType(
    {
        "about": VerbType(None, AboutReply),
        "hello": VerbType(None, MiningSettings),
        "claim": VerbType(ClaimRequest, ClaimReply, writes=True),
        "renew": VerbType(RenewRequest, Answer, writes=True),
        "commit": VerbType(CommitRequest, Answer, writes=True, most_bytes=MAX_COMMIT_BYTES),
        "backlog": VerbType(None, WorkBacklog),
        "fail": VerbType(FailRequest, Answer, writes=True),
        "top": VerbType(TopRequest, TopReply, reads_all=True),
        "select": VerbType(SelectRequest, Selection, writes=True),
        "propose": VerbType(ProposeRequest, Proposal, reads_all=True),
        "selection": VerbType(SelectionRequest, Selection),
        "selections": VerbType(None, SelectionsReply, reads_all=True),
        "overlay": VerbType(SceneRequest, None),
        "status": VerbType(None, Status, reads_all=True),
        "scene": VerbType(SceneRequest, SceneScore),
        "modes": VerbType(None, ModesReply, reads_all=True),
        "compare": VerbType(CompareRequest, Comparison, reads_all=True),
        "rates": VerbType(RatesRequest, RatesReply, reads_all=True),
        "scenes": VerbType(ScenesRequest, ScenesReply),
        "judge": VerbType(JudgeRequest, VerdictRow, writes=True),
        "undo": VerbType(UndoRequest, VerdictRow, writes=True),
        "verdicts": VerbType(VerdictsRequest, VerdictsReply),
        "agreement": VerbType(AgreementRequest, AgreementReply, reads_all=True),
        "activity": VerbType(ActivityRequest, ActivityReply, reads_all=True),
        "choices": VerbType(None, ChoicesReply),
        "retry": VerbType(RetryRequest, RetryReply, writes=True),
        "exported": VerbType(ExportedRequest, AuditedReply, writes=True),
        "audit": VerbType(AuditRequest, AuditReply),
    }
)
"""Every verb. `service.api.control.Control.answer_VERB` answers it."""

OF_WORKERS: Final = ("claim", "renew", "commit", "fail")
"""Verbs that a worker asks under its own id: another worker's leases are none of its."""

OF_PEOPLE: Final = ("select", "judge", "undo", "retry", "exported")
"""Verbs that the audit log reports, asked under the name of a certificate."""

HISTORY: Final = "history"
"""The scenes and selections that there are: asked by their keys, so it is no verb of the table."""

ASKED: Final = (*VERBS, HISTORY)
"""Everything that is asked and counted."""
