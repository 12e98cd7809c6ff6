"""Messages of clients to the service, in addition to the leases of `schemas.work`."""

from collections.abc import Sequence
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.attribution import Chance
from schemas.bounds import (
    MAX_LISTED,
    MAX_LOGS_NAMED,
    MAX_SCENES_ASKED,
    MAX_SCENES_CHOSEN,
    Count,
    LogId,
    Name,
    Said,
    SceneId,
)
from schemas.transport.wire import first_problem
from schemas.verdict import VerdictRow
from service.curation.learned_effect import LearnedEffect
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow
from service.curation.selection import SelectionSummary, SelectionTerms
from service.curation.status import ParkedWork
from service.curation.verdicts import MAX_VERDICTS_ASKED
from service.errors import UsageError

_STRICT = ConfigDict(frozen=True, extra="forbid")


WithVerdicts = Annotated[
    bool,
    Field(
        exclude_if=lambda value: not value,
        description="Give each row its verdicts; absent: no, since earlier clients refuse them.",
    ),
]

Request = TypeVar("Request", bound=BaseModel)


class AboutReply(BaseModel):
    """Identity and version of the service; clients of any version ignore unknown fields."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    package: Said = Field(description="Version of the package at its start.")


class TopRequest(BaseModel):
    """Request for the ranking."""

    model_config = _STRICT

    most: int | None = Field(
        default=None,
        ge=1,
        le=MAX_SCENES_ASKED,
        description="Number of rows at most; None: all.",
    )
    verdicts: WithVerdicts = False
    learned: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="Rank by what verdicts teach, where this is better; absent: by the score.",
    )


class Learned(BaseModel):
    """Effect of a learned ranking, and the chance of each row."""

    model_config = _STRICT

    effect: LearnedEffect
    chances: tuple[Chance, ...] = Field(
        fail_fast=True,
        max_length=MAX_LISTED,
        description="By row: that the supervised stream is wrong; the score where this ranks.",
    )


class TopReply(BaseModel):
    """The ranking, best first."""

    model_config = _STRICT

    scenes: tuple[RankedScene, ...] = Field(fail_fast=True, max_length=MAX_LISTED)
    learned: Learned | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Absent where it was not requested.",
    )


class RatesReply(BaseModel):
    """Reply to a `service.curation.rates.RatesRequest`, worst group first."""

    model_config = _STRICT

    rows: tuple[RateRow, ...] = Field(fail_fast=True, max_length=MAX_LISTED)


class SelectRequest(BaseModel):
    """Request to make, store and publish a named selection."""

    model_config = _STRICT

    budget: int = Field(ge=1, le=MAX_SCENES_ASKED, description="Scenes the labellers can take.")
    name: Name | None = Field(default=None, description="None: the service names it.")
    scenes: tuple[SceneId, ...] | None = Field(
        default=None,
        max_length=MAX_SCENES_CHOSEN,
        exclude_if=lambda value: value is None,
        description="Scenes that a person chose; None: the strategy chooses.",
    )
    terms: SelectionTerms = Field(
        default=SelectionTerms(),
        exclude_if=lambda value: value == SelectionTerms(),
        description="How the scenes are chosen.",
    )
    verdicts: WithVerdicts = False


class ProposeRequest(BaseModel):
    """Request for the choice that a selection would store now; nothing is stored."""

    model_config = _STRICT

    budget: int = Field(ge=1, le=MAX_SCENES_ASKED, description="Scenes the labellers can take.")
    name: Name | None = Field(
        default=None, description="Selection to compare with; None: it would be a new one."
    )
    terms: SelectionTerms = SelectionTerms()


class SelectionRequest(BaseModel):
    """Request for one stored selection."""

    model_config = _STRICT

    name: Name
    verdicts: WithVerdicts = False


class SelectionsReply(BaseModel):
    """Every stored selection without its scenes, oldest first."""

    model_config = _STRICT

    selections: tuple[SelectionSummary, ...] = Field(fail_fast=True, max_length=MAX_LISTED)


class VerdictsReply(BaseModel):
    """A page of verdicts, latest first."""

    model_config = _STRICT

    rows: tuple[VerdictRow, ...] = Field(max_length=MAX_VERDICTS_ASKED)
    next: Count | None = Field(description="`before` of the next page; null: this is the last.")


def verdicts_reply(rows: Sequence[VerdictRow], *, most: int) -> VerdictsReply:
    """Return a page of verdicts, of one row more than it shows where there is a next page."""
    shown = tuple(rows[:most])
    return VerdictsReply(rows=shown, next=shown[-1].ordinal if len(rows) > most else None)


class SceneRequest(BaseModel):
    """Request for the record, or the overlay, of one current scene."""

    model_config = _STRICT

    scene_id: SceneId
    withdrawn: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="Accept the last record of a scene that is no longer current, too.",
    )


class RetryRequest(BaseModel):
    """Request to retry parked work, or to plan refused logs again."""

    model_config = _STRICT

    log_ids: tuple[LogId, ...] | None = Field(
        default=None,
        max_length=MAX_LOGS_NAMED,
        description="Logs whose work is retried, refused plans included; None: all parked work.",
    )
    refused: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="Without names, plan all refused logs again in place of parked work.",
    )


class RetryReply(BaseModel):
    """Work that is retried, each item with the attempts and the error it was parked with."""

    model_config = _STRICT

    retried: tuple[ParkedWork, ...] = Field(fail_fast=True, max_length=MAX_LISTED)


def checked_request(kind: type[Request], /, **fields: Any) -> Request:
    """Make a request from the values that a user gave.

    Raises:
        UsageError: If a value exceeds the bounds of the request; the message names the field.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise UsageError(f"invalid request: {first_problem(error)}") from None
