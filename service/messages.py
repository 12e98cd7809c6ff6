"""What is asked of the service from outside, beside the leases of `schemas.work`."""

from pydantic import BaseModel, ConfigDict, Field

from service.ranking import RankedScene
from service.rates import RateRow
from service.status import ParkedWork

_STRICT = ConfigDict(frozen=True, extra="forbid")


class AboutReply(BaseModel):
    """Which program the service is; later fields are passed over, so that any version can ask."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    package: str = Field(description="Version of the package, as it was started.")


class TopRequest(BaseModel):
    """Asks for the ranking."""

    model_config = _STRICT

    most: int | None = Field(default=None, ge=1, description="Only the first so many; None: all.")


class TopReply(BaseModel):
    """The ranking, best first."""

    model_config = _STRICT

    scenes: tuple[RankedScene, ...]


class RatesReply(BaseModel):
    """The answer to a `service.rates.RatesRequest`, in the order it is read in."""

    model_config = _STRICT

    rows: tuple[RateRow, ...]


class SelectRequest(BaseModel):
    """Asks for a named selection to be made, stored and published."""

    model_config = _STRICT

    budget: int = Field(ge=1, description="Scenes the labellers can take.")
    name: str | None = Field(default=None, min_length=1, description="None: the service names it.")


class SceneRequest(BaseModel):
    """Asks for the record, or the overlay, of one current scene."""

    model_config = _STRICT

    scene_id: str = Field(min_length=1)


class RetryRequest(BaseModel):
    """Asks for parked work to be tried again."""

    model_config = _STRICT

    log_ids: tuple[str, ...] | None = Field(
        default=None, description="Only that of these logs; None: all that is parked."
    )


class RetryReply(BaseModel):
    """What is tried again from now on, each with the attempts and the error it was parked with."""

    model_config = _STRICT

    retried: tuple[ParkedWork, ...]
