"""What is asked of the service from outside, beside the leases of `schemas.work`."""

from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.bounds import (
    MAX_LISTED,
    MAX_LOGS_NAMED,
    MAX_SCENES_ASKED,
    LogId,
    Name,
    Said,
    SceneId,
)
from schemas.transport.wire import first_problem
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow
from service.curation.status import ParkedWork
from service.errors import UsageError

_STRICT = ConfigDict(frozen=True, extra="forbid")


Request = TypeVar("Request", bound=BaseModel)


class AboutReply(BaseModel):
    """Which program the service is; later fields are passed over, so that any version can ask."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    package: Said = Field(description="Version of the package, as it was started.")


class TopRequest(BaseModel):
    """Asks for the ranking."""

    model_config = _STRICT

    most: int | None = Field(
        default=None,
        ge=1,
        le=MAX_SCENES_ASKED,
        description="Only the first so many; None: all.",
    )


class TopReply(BaseModel):
    """The ranking, best first."""

    model_config = _STRICT

    scenes: tuple[RankedScene, ...] = Field(max_length=MAX_LISTED)


class RatesReply(BaseModel):
    """The answer to a `service.curation.rates.RatesRequest`, in the order it is read in."""

    model_config = _STRICT

    rows: tuple[RateRow, ...] = Field(max_length=MAX_LISTED)


class SelectRequest(BaseModel):
    """Asks for a named selection to be made, stored and published."""

    model_config = _STRICT

    budget: int = Field(ge=1, le=MAX_SCENES_ASKED, description="Scenes the labellers can take.")
    name: Name | None = Field(default=None, description="None: the service names it.")


class SceneRequest(BaseModel):
    """Asks for the record, or the overlay, of one current scene."""

    model_config = _STRICT

    scene_id: SceneId


class RetryRequest(BaseModel):
    """Asks for parked work to be tried again."""

    model_config = _STRICT

    log_ids: tuple[LogId, ...] | None = Field(
        default=None,
        max_length=MAX_LOGS_NAMED,
        description="Only that of these logs; None: all that is parked.",
    )


class RetryReply(BaseModel):
    """What is tried again from now on, each with the attempts and the error it was parked with."""

    model_config = _STRICT

    retried: tuple[ParkedWork, ...] = Field(max_length=MAX_LISTED)


def question(kind: type[Request], **fields: Any) -> Request:
    """Make a question of what a person gave.

    Raises:
        UsageError: If it is beyond the bounds of the question; the message says which field.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise UsageError(f"cannot be asked: {first_problem(error)}") from None
