"""Paged listing of current scenes: its filters, its orders, its rows and its cursor. Pure."""

import base64
import binascii
import json
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from schemas.attribution import Wrong
from schemas.bounds import (
    MAX_LOG_ID,
    MAX_TEXT,
    NO_NUL,
    Count,
    Kept,
    Name,
    Said,
    StampNs,
)
from schemas.contradiction import KindName
from schemas.events import MAX_LISTED_TRACKS, TrackSummary
from schemas.score import Share
from schemas.verdict import VerdictSummary
from service.curation.ranges import Beyond, Within
from service.errors import UsageError

MAX_PAGE: Final = 200
"""Rows of a page at most."""

MOST_COUNTED: Final = 10_000
"""Matches of a search that are counted; of a common word there may be a million."""

SceneOrder = Literal["score", "newest", "earliest", "latest", "judged"]
"""Order of a listing. `score`: best first, as the ranking, scenes without a valid score last.
`newest`: last committed first. `earliest`, `latest`: by time of recording. `judged`: most recently
judged first, and only scenes with a verdict.
"""

JudgedFilter = Literal["any", "yes", "no", "mine", "not_mine"]
"""Filter by verdicts on the shown record: by any reviewer, or by the one who asks."""

Words = Annotated[str, Field(max_length=MAX_TEXT, pattern=NO_NUL)]


class ScenesRequest(BaseModel):
    """Request for a page of current scenes; filters that are not given let everything pass."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    vehicle: Said | None = None
    software_version: Said | None = None
    kind: KindName | None = Field(default=None, description="Of a strong track.")
    class_name: Said | None = Field(default=None, description="Of a strong track, in any case.")
    wrong: Wrong | None = Field(default=None, description="Attribution of a strong track.")
    mode: Said | None = Field(
        default=None, description="Supervised stream, `name` or `name@version`."
    )
    beyond_m: Beyond | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Range of a strong track, whole metres: greater than this.",
    )
    within_m: Within | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Range of a strong track, whole metres: at most this. Filters of kind, class, "
        "attribution and range are passed by one track.",
    )
    since_ns: StampNs | None = Field(default=None, description="Begins at or after.")
    until_ns: StampNs | None = Field(default=None, description="Begins before.")
    min_score: Share | None = None
    max_score: Share | None = None
    judged: JudgedFilter = "any"
    reviewer: Name | None = Field(
        default=None, description="Who asks: for `mine` of each row, and the filters by it."
    )
    log: Annotated[str, Field(max_length=MAX_LOG_ID, pattern=NO_NUL)] | None = Field(
        default=None, description="Pattern of the whole log id; `*` also crosses `/`."
    )
    text: Words = Field(
        default="", description="Part of the scene's id or headlines, in any case; or a short name."
    )
    selection: Name | None = Field(default=None, description="Only scenes of this selection.")
    sort: SceneOrder = "score"
    after: Annotated[str, Field(max_length=512, pattern=NO_NUL)] = Field(
        default="", description="`next` of the page before; empty: the first page."
    )
    most: int = Field(default=50, ge=1, le=MAX_PAGE)

    @field_validator("within_m")
    @classmethod
    def _is_beyond_the_other_bound(cls, within_m: int | None, info: ValidationInfo) -> int | None:
        beyond_m = info.data.get("beyond_m")
        if within_m is not None and beyond_m is not None and within_m <= beyond_m:
            raise PydanticCustomError(
                "no_range", "Input should be greater than beyond, which is {m} m", {"m": beyond_m}
            )
        return within_m


class ListedScene(BaseModel):
    """One current scene of a page."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scene_id: Kept = Field(description="`<log_id>/<lidar>/<start_ns>`.")
    log_id: Kept
    lidar_topic: Kept
    name: Kept = Field(description="Last part of the log id, and begin of the scene in UTC.")
    vehicle: Kept
    software_version: Kept
    start_ns: StampNs
    end_ns: StampNs
    state: Kept = Field(description="`scored`, or why it has no valid score.")
    score: Share
    seq: Count = Field(description="Number of its event.")
    sha256: Kept = Field(description="Digest of its record.")
    headline: Kept = Field(description="Of its first reason; empty without one.")
    kind: Kept = Field(description="Of its strongest track; empty without a strong one.")
    class_name: Kept = Field(description="The same.")
    wrong: Wrong | None = Field(description="Attribution of its strongest track.")
    strength: Share = Field(description="Of its strongest track; 0 without a strong one.")
    tracks: tuple[TrackSummary, ...] = Field(max_length=MAX_LISTED_TRACKS)
    verdicts: VerdictSummary


class ScenesReply(BaseModel):
    """A page of current scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rows: tuple[ListedScene, ...] = Field(max_length=MAX_PAGE)
    next: str = Field(max_length=512, description="Cursor of the next page; empty: the last one.")
    total: Count = Field(description="Scenes that pass the filters now, on all pages.")
    is_least: bool = Field(
        default=False,
        description="There are more than `total`: matches of a search are counted up to 10,000.",
    )


def passes(track: TrackSummary, request: ScenesRequest) -> bool:
    """Return true if a strong track passes all filters of tracks: kind, class, who errs, range."""
    return (
        request.kind in (None, track.kind)
        and (
            request.class_name is None
            or is_class(track.class_name.replace("|", "/"), wanted=request.class_name)
        )
        and request.wrong in (None, track.wrong)
        and (not request.beyond_m or track.range_m > request.beyond_m)
        and (request.within_m is None or track.range_m <= request.within_m)
    )


def is_class(class_name: str, *, wanted: str) -> bool:
    """Return true if a class is the wanted one, in any case: one model writes Car, another car."""
    return class_name.casefold() == wanted.casefold()


def cursor_of(order: SceneOrder, keys: tuple[float | int, ...]) -> str:
    """Encode the place of a row: the order, and the row's values in it."""
    return base64.urlsafe_b64encode(json.dumps([order, *keys]).encode()).decode()


def keys_of(order: SceneOrder, cursor: str, *, count: int) -> tuple[float | int, ...]:
    """Decode the place after which a page begins.

    Raises:
        UsageError: If it is no cursor of this order.
    """
    try:
        found = json.loads(base64.urlsafe_b64decode(cursor.encode()))
        named, *keys = found
        numbers = all(isinstance(key, int | float) and abs(key) < 2**63 for key in keys)
        if named != order or len(keys) != count or not numbers:
            raise ValueError
    except (ValueError, TypeError, binascii.Error):
        raise UsageError(
            f"no cursor of a listing by {order}: {cursor[:60]!r}; begin with the first page"
        ) from None
    return tuple(keys)
