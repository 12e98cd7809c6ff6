"""Routes of scenes: the listing, the ranking, one record, and its overlay by byte ranges."""

import re
from collections.abc import Iterator
from typing import Annotated, Final

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from schemas.bounds import MAX_SCENE_ID, MAX_SCENES_ASKED, NO_NUL
from schemas.canonical import sha256
from schemas.transport.overlay_file import OverlayFile
from schemas.transport.wire import encode
from service.api.messages import TopReply
from service.curation.listing import ScenesRequest
from service.errors import UsageError
from service.http.context import JSON, answer, api_of, next_page, route, source_of, turn_of
from service.http.problems import problem

router = APIRouter(tags=["scenes"])

USUAL_RANKS: Final = 100
"""Rows of the ranking that are given where their number is not asked for."""

CHUNK_BYTES: Final = 2**22
"""Bytes of an overlay that are read and sent at a time."""

OVERLAY: Final = "application/octet-stream"

_RANGE: Final = re.compile(r"bytes=(\d{0,15})-(\d{0,15})", re.ASCII)

SceneIdInPath = Annotated[
    str,
    Path(
        min_length=1,
        max_length=MAX_SCENE_ID,
        pattern=NO_NUL,
        description="`<log_id>/<lidar>/<start_ns>`, percent-encoded.",
    ),
]


class RankingQuery(BaseModel):
    """Query of the ranking."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    most: int = Field(
        default=USUAL_RANKS, ge=1, le=MAX_SCENES_ASKED, description="Number of rows at most."
    )


class SceneQuery(BaseModel):
    """Query of one scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    withdrawn: bool = Field(
        default=False, description="Accept the last record of a scene that is no longer current."
    )


@route(router, "scenes", summary="List current scenes")
def scenes(request: Request, asked: Annotated[ScenesRequest, Query()]) -> Response:
    """List current scenes by filters and order, page by page.

    `next` is `after` of the next page, and the `Link` header has its address. Pages stay complete
    while scenes arrive.
    """
    if asked.judged in ("mine", "not_mine") and asked.reviewer is None:
        raise UsageError(f"judged={asked.judged} needs the reviewer: give reviewer as well")
    found = source_of(request).scenes(asked)
    headers = next_page(request, after=found.next) if found.next else {}
    return answer(found, headers=headers)


@route(router, "top", summary="Rank scenes")
def ranking(request: Request, asked: Annotated[RankingQuery, Query()]) -> Response:
    """Rank current scenes, best first, with twins and strong tracks."""
    with turn_of(request) as source:
        rows = tuple(source.top(asked.most))
    return answer(TopReply(scenes=rows))


@route(
    router,
    "overlay",
    summary="Points and labels of a scene",
    response_class=Response,
    responses={
        200: {"content": {OVERLAY: {}}, "description": "The overlay, as WIRE.md describes it."},
        206: {"content": {OVERLAY: {}}, "description": "The range that was asked for."},
        304: {"description": "It is the one that the client has."},
        412: {"description": "It is another one than `If-Match` names."},
        416: {"description": "The range begins beyond its end."},
    },
)
def overlay(request: Request, scene_id: SceneIdInPath) -> Response:
    """Send the stored points, labels and pictures of a scene, whole or by one range of bytes.

    The `ETag` changes with the record of the scene. Source of ranges: RFC 9110, section 14.
    """
    api, headers = api_of(request), request.headers
    digest = sha256(api.source.record(scene_id))
    etag = f'"{digest}"'
    if _names(headers.get("if-none-match"), etag):
        return Response(status_code=304, headers={"etag": etag, "cache-control": "no-cache"})
    wanted = headers.get("if-match")
    if wanted is not None and not _names(wanted, etag):
        return problem("the scene was mined again: begin with its new overlay", status=412)
    opened = api.overlays.of(api.source, scene_id, digest)
    size = max(offset + length for offset, length in opened.header.blocks())
    sent = {"etag": etag, "accept-ranges": "bytes", "cache-control": "no-cache"}
    asked = headers.get("range")
    if asked is not None and headers.get("if-range", etag) == etag:
        found = _RANGE.fullmatch(asked.strip())
        if found is not None and found.groups() != ("", ""):
            return _part(opened, size, *found.groups(), sent=sent)
    sent["content-length"] = str(size)
    return StreamingResponse(_chunks(opened, 0, size), headers=sent, media_type=OVERLAY)


router.add_api_route(
    "/scenes/{scene_id:path}/overlay", overlay, methods=["HEAD"], include_in_schema=False
)


@route(
    router,
    "scene",
    summary="Record of a scene",
    responses={304: {"description": "It is the one that the client has."}},
)
def scene(
    request: Request, scene_id: SceneIdInPath, asked: Annotated[SceneQuery, Query()]
) -> Response:
    """Return the record of a scene: score, reasons, tracks, evidence.

    With `withdrawn` it is the record as published, byte for byte.
    """
    source = source_of(request)
    record = source.record(scene_id) if asked.withdrawn else encode(source.scene(scene_id))
    headers = {"etag": f'"{sha256(record)}"', "cache-control": "no-cache"}
    if _names(request.headers.get("if-none-match"), headers["etag"]):
        return Response(status_code=304, headers=headers)
    return Response(record, headers=headers, media_type=JSON)


def _names(listed: str | None, etag: str) -> bool:
    """Return true if a header lists a tag; weak tags compare like strong ones."""
    tags = (each.strip().removeprefix("W/") for each in (listed or "")[:4096].split(","))
    return any(tag in (etag, "*") for tag in tags)


def _part(
    opened: OverlayFile, size: int, first: str, last: str, *, sent: dict[str, str]
) -> Response:
    """Answer with one range, `first-last`, `first-` or `-length`."""
    begin = int(first) if first else max(0, size - int(last))
    end = min(size, int(last) + 1) if first and last else size
    if begin >= size or (first and last and int(last) < begin):
        unmet = {"content-range": f"bytes */{size}"}
        sentence = f"this range lies beyond the {size} bytes of the overlay"
        return problem(sentence, status=416, headers=unmet)
    headers = sent | {
        "content-range": f"bytes {begin}-{end - 1}/{size}",
        "content-length": str(end - begin),
    }
    return StreamingResponse(_chunks(opened, begin, end), 206, headers=headers, media_type=OVERLAY)


def _chunks(opened: OverlayFile, begin: int, end: int) -> Iterator[bytes]:
    for at in range(begin, end, CHUNK_BYTES):
        yield opened.read(at, min(CHUNK_BYTES, end - at))
