"""Server-sent events: new scenes that pass the filters of a page, and the progress."""

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from functools import partial
from threading import Event
from typing import Any, Final, cast

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from schemas.errors import PermanentError, TransientError
from service.api.reader import Reader
from service.curation.listing import MAX_PAGE, ScenesRequest
from service.curation.verdicts import VerdictsRequest
from service.errors import UsageError
from service.web.context import source_of, visitor_of
from service.web.filters import Filters
from service.web.kept import Kept
from service.web.progress import progress_of, summary

router = APIRouter()

LOOK_EVERY_S: Final = 1.0
"""Interval at which the newest scene and verdict are asked for, once for all pages, seconds."""

KEEP_ALIVE_S: Final = 15.0
"""Interval of empty lines, by which a browser that has left is noticed, seconds."""


class Newest:
    """Numbers of the newest scene and verdict, asked for at most once in LOOK_EVERY_S."""

    def __init__(self) -> None:
        """Begin with nothing known."""
        self._kept: Kept[tuple[int, int]] = Kept(age_s=LOOK_EVERY_S)
        self._last = (0, 0)

    def of(self, source: Reader) -> tuple[int, int]:
        """Return the numbers; the last known ones while the source does not answer."""
        with suppress(PermanentError, TransientError):
            self._last = self._kept.of("newest", partial(_numbers, source))
        return self._last


def newest_of(request: Request) -> tuple[int, int]:
    """Return the numbers of the newest scene and verdict."""
    return cast(Newest, request.app.state.newest).of(source_of(request))


def _numbers(source: Reader) -> tuple[int, int]:
    scenes = source.scenes(ScenesRequest(sort="newest", most=1)).rows
    verdicts = source.verdicts(VerdictsRequest(current=False, most=1)).rows
    return (scenes[0].seq if scenes else 0, verdicts[0].ordinal if verdicts else 0)


@router.get("/live")
async def live(request: Request) -> Response:
    """Stream the events of one page until it is closed."""
    filters = Filters.of(request.query_params)
    since = request.query_params.get("since_seq", "0")
    if not (since.isascii() and since.isdecimal() and len(since) < 19):
        raise UsageError("since_seq is the number of a scene")
    _asked(request, filters)  # refuses filters that are not possible, before the stream begins
    stream = _events(request, filters, int(since))
    return StreamingResponse(stream, media_type="text/event-stream")


async def _events(request: Request, filters: Filters, since: int) -> AsyncIterator[str]:
    closing = cast(Event, request.app.state.closing)
    scene, verdict = since, (await run_in_threadpool(newest_of, request))[1]
    said_s = time.monotonic()
    yield "retry: 2000\n\n"
    while not closing.is_set():
        last_scene, last_verdict = await run_in_threadpool(newest_of, request)
        if last_scene > scene:
            scene = last_scene
            count = await run_in_threadpool(_new_scenes, request, filters, since)
            yield _event("scenes", {"count": count, "seq": scene})
            said_s = time.monotonic()
        if last_verdict != verdict:
            verdict = last_verdict
            yield _event("progress", await run_in_threadpool(_progress, request, filters))
            said_s = time.monotonic()
        if time.monotonic() - said_s >= KEEP_ALIVE_S:
            yield ": still here\n\n"
            said_s = time.monotonic()
        await asyncio.sleep(LOOK_EVERY_S / 4)


def _event(name: str, data: dict[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n"


def _new_scenes(request: Request, filters: Filters, since: int) -> int:
    """Count the scenes after a number that pass the filters, MAX_PAGE at most."""
    try:
        rows = source_of(request).scenes(_asked(request, filters)).rows
    except (PermanentError, TransientError):
        return 0
    return sum(row.seq > since for row in rows)


def _asked(request: Request, filters: Filters) -> ScenesRequest:
    return filters.request(
        reviewer=visitor_of(request).reviewer,
        now_s=time.clock_gettime(time.CLOCK_REALTIME),
        most=MAX_PAGE,
        sort="newest",
        after="",
    )


def _progress(request: Request, filters: Filters) -> dict[str, Any]:
    visitor, progress = visitor_of(request), progress_of(request)
    progress.forget()
    try:
        found = progress.of(source_of(request), filters.given.get("selection", ""))
    except (PermanentError, TransientError):
        return {"text": ""}
    return summary(found, reviewer=visitor.reviewer, budget=visitor.budget)
