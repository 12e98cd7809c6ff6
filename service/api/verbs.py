"""Table of the verbs on the bus, with the request and the reply of each."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pydantic import BaseModel

from schemas.bounds import MAX_COMMIT_BYTES, MAX_QUESTION_BYTES
from schemas.mining import MiningSettings
from schemas.score import SceneScore
from schemas.transport.keys import Verb
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
    RatesReply,
    RetryReply,
    RetryRequest,
    SceneRequest,
    SelectRequest,
    TopReply,
    TopRequest,
)
from service.curation.rates import RatesRequest
from service.curation.selection import Selection
from service.curation.status import Status


@dataclass(frozen=True, slots=True)
class VerbType:
    """Types and limits of one verb.

    Attributes:
        request: Request message; None: no payload, and one that is sent is ignored.
        reply: Reply message; None: the bytes of an overlay.
        writes: True if the reply waits for a transaction.
        most_bytes: Largest payload, bytes; a longer one is refused before it is read.
    """

    request: type[BaseModel] | None
    reply: type[BaseModel] | None
    writes: bool = False
    most_bytes: int = MAX_QUESTION_BYTES


VERBS: Final[Mapping[Verb, VerbType]] = MappingProxyType(
    {
        "about": VerbType(None, AboutReply),
        "hello": VerbType(None, MiningSettings),
        "claim": VerbType(ClaimRequest, ClaimReply, writes=True),
        "renew": VerbType(RenewRequest, Answer, writes=True),
        "commit": VerbType(CommitRequest, Answer, writes=True, most_bytes=MAX_COMMIT_BYTES),
        "fail": VerbType(FailRequest, Answer, writes=True),
        "top": VerbType(TopRequest, TopReply),
        "select": VerbType(SelectRequest, Selection, writes=True),
        "status": VerbType(None, Status),
        "rates": VerbType(RatesRequest, RatesReply),
        "scene": VerbType(SceneRequest, SceneScore),
        "overlay": VerbType(SceneRequest, None),
        "retry": VerbType(RetryRequest, RetryReply, writes=True),
    }
)
"""Entry of every verb of `schemas.transport.keys.Verb`."""
