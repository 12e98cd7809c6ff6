"""Scene page: the viewer with its data, the record's evidence, and the form of a verdict."""

import io
import json
import threading
import time
from collections.abc import Mapping
from glob import escape
from typing import Annotated, Any, Final, cast
from zlib import crc32

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from schemas.arrays import NS_PER_S
from schemas.errors import PermanentError, TransientError
from schemas.score import SceneScore
from schemas.transport.overlay_file import OverlayFile
from service.api.overlay_cache import OpenOverlays, SeenScene, seen_scene
from service.api.reader import Reader, overlay_of
from service.curation.listing import ListedScene, ScenesRequest
from service.curation.verdicts import CAUSES, ChoicesReply, VerdictsRequest
from service.pictures.scene import draw_scene
from service.pictures.title import title_of
from service.web.context import render, source_of, visitor_of
from service.web.filters import Filters
from service.web.kept import Kept
from service.web.phrases import VERDICT_NAMES
from service.web.ranking import kind_class
from service.web.scene_facts import viewer_facts
from service.web.scene_links import links_of
from service.web.scene_order import href_of, order_of
from service.web.scene_story import around, blind_spots, is_strong, same_things, stories_of
from service.web.source import opened_once

router = APIRouter()

SceneId = Annotated[str, Query(alias="id")]

IMMUTABLE: Final = "private, max-age=31536000, immutable"
"""A block never changes: its address has the digest of the record."""

AROUND_NS: Final = 30 * NS_PER_S
MOST_AROUND: Final = 60
MOST_VERDICTS: Final = 100

NEAREST: Final = 3
"""Neighbours whose records are compared for the same thing."""

WITHDRAWN: Final = (
    "This scene is withdrawn: its log was replaced, deleted, or mined again with other results. "
    "The last record is shown; a verdict on it is stored with its digest."
)

GIVEN: Final = {name: words for name, words in VERDICT_NAMES.items() if name != "withdrawn"}
"""Verdicts in the order of their keys, 1 to 6."""

_DRAWING: Final = threading.BoundedSemaphore(2)


@router.get("/scene")
def scene_page(request: Request, scene_id: SceneId = "") -> Response:
    """Answer with the page of a scene; without its overlay the page names the problem."""
    with opened_once(source_of(request)) as source:
        return render(request, "scene.html", **_context_of(request, source, scene_id))


def _context_of(request: Request, source: Reader, scene_id: str) -> dict[str, Any]:
    """Return what the template of a scene shows."""
    reviewer = visitor_of(request).reviewer
    seen = seen_scene(source, scene_id)
    score, filters = seen.score, Filters.of(request.query_params)
    rows = rows_around(source, seen, reviewer)
    row = next((each for each in rows if each.scene_id == scene_id), None)
    facts, problem = facts_of(request, source, seen, is_current=row is not None)
    neighbours = around(rows, score)
    verdicts = source.verdicts(VerdictsRequest(scene_id=scene_id, most=MOST_VERDICTS)).rows
    stories = stories_of(score)
    choices = cast(Kept[ChoicesReply], request.app.state.choices).of("", source.choices)
    moment_ns = score.tracks[0].strongest.stamp_ns if score.tracks else score.start_ns
    return {
        "seen": seen,
        "score": score,
        "name": row.name if row else title_of(score).name,
        "headline": headline_of(seen),
        "remarks": [reason for reason in score.reasons if reason.track_id is None],
        "kind_class": kind_class(score.tracks[0].kind) if score.tracks else "",
        "kind_classes": {track.track_id: kind_class(track.kind) for track in score.tracks},
        "stories": stories,
        "blind": blind_spots(score),
        "facts": facts,
        "first_frame": _first_frame(request, facts),
        "problem": problem or ("" if row else WITHDRAWN),
        "neighbours": [(each, href_of(each.scene_id)) for each in neighbours],
        "shared": same_things(score, _records(source, score, neighbours)),
        "mine": [each for each in verdicts if each.reviewer == reviewer],
        "others": [each for each in verdicts if each.reviewer != reviewer],
        "given": GIVEN,
        "causes": [(name, CAUSES.get(name, name)) for name in choices.causes],
        "links": links_of(choices.bucket, score.log_id, moment_ns),
        "order": order_of(
            source,
            score,
            filters,
            reviewer=reviewer,
            now_s=time.clock_gettime(time.CLOCK_REALTIME),
        ),
        "selection": filters.given.get("selection", ""),
        "list_query": filters.query(after=None),
    }


@router.get("/data/scene")
def scene_data(request: Request, scene_id: SceneId = "") -> Response:
    """Answer with a scene as JSON: record, header of its overlay, neighbours, verdicts, links."""
    source = source_of(request)
    seen = seen_scene(source, scene_id)
    rows = rows_around(source, seen, visitor_of(request).reviewer)
    facts: dict[str, Any] = {
        "sha256": seen.digest,
        "is_current": any(row.scene_id == scene_id for row in rows),
        "record": json.loads(seen.record),
        "neighbours": [row.model_dump(mode="json") for row in around(rows, seen.score)],
        "verdicts": [
            row.model_dump(mode="json")
            for row in source.verdicts(VerdictsRequest(scene_id=scene_id, most=MOST_VERDICTS)).rows
        ],
    }
    try:
        opened = overlays_of(request).of(source, scene_id, seen.digest)
        facts["overlay"] = json.loads(opened.header_json)
    except PermanentError as error:
        facts["overlay"], facts["problem"] = None, str(error)
    return Response(json.dumps(facts), media_type="application/json")


@router.get("/data/frame")
def frame(request: Request, scene_id: SceneId = "", digest: str = "", n: int = 0) -> Response:
    """Answer with the view block of a frame, as stored."""
    return _block(request, scene_id, digest, kind="view", number=n)


@router.get("/data/rest")
def rest(request: Request, scene_id: SceneId = "", digest: str = "", n: int = 0) -> Response:
    """Answer with the rest block of a frame, as stored."""
    return _block(request, scene_id, digest, kind="rest", number=n)


@router.get("/data/image")
def image(request: Request, scene_id: SceneId = "", digest: str = "", n: int = 0) -> Response:
    """Answer with a camera picture, as stored."""
    found = overlays_of(request)
    data = found.block(source_of(request), scene_id, digest, kind="picture", number=n)
    entry = found.of(source_of(request), scene_id, digest).header.pictures[n]
    return _kept(request, data, {}, media_type=entry.media_type)


@router.get("/picture.png")
def picture(request: Request, scene_id: SceneId = "") -> Response:
    """Answer with the picture of a scene, drawn by the server for pages without script."""
    source = source_of(request)
    score = source.scene(scene_id)
    with _DRAWING:
        drawn = draw_scene(score, overlay_of(source, scene_id), title=title_of(score))
    file = io.BytesIO()
    drawn.save(file, "PNG")
    return _kept(request, file.getvalue(), {}, media_type="image/png", cache="private, max-age=300")


def overlays_of(request: Request) -> OpenOverlays:
    """Return the open overlays of the application."""
    return cast(OpenOverlays, request.app.state.overlays)


def headline_of(seen: SeenScene) -> str:
    """Return the headline of a record: its first reason, or a sentence that there is none."""
    if seen.score.reasons:
        return seen.score.reasons[0].headline
    return "No contradiction in this scene"


def rows_around(source: Reader, seen: SeenScene, reviewer: str) -> tuple[ListedScene, ...]:
    """Return the listed scenes of a log half a minute around a scene, with itself if current."""
    score = seen.score
    asked = ScenesRequest(
        log=escape(score.log_id),
        since_ns=max(0, score.start_ns - AROUND_NS),
        until_ns=score.end_ns + AROUND_NS,
        sort="earliest",
        most=MOST_AROUND,
        reviewer=reviewer or None,
    )
    return source.scenes(asked).rows


def facts_of(
    request: Request, source: Reader, seen: SeenScene, *, is_current: bool
) -> tuple[dict[str, Any] | None, str]:
    """Return the facts for the viewer; or None and a sentence where there is nothing to view."""
    if not is_current:
        return None, ""
    try:
        opened = overlays_of(request).of(source, seen.score.scene_id, seen.digest)
    except (PermanentError, TransientError) as error:
        return None, f"The points of this scene cannot be shown: {error}"
    return viewer_facts(seen.score, opened.header) | _addresses(seen, opened), ""


def _first_frame(request: Request, facts: dict[str, Any] | None) -> int:
    """Return the frame that the viewer loads first: that of the address, or the strongest."""
    if facts is None:
        return 0
    asked = request.query_params.get("frame", "")
    known = asked.isascii() and asked.isdecimal() and int(asked[:6]) < len(facts["frames"])
    track = request.query_params.get("track", "")
    frames = {str(each["id"]): each["frame"] for each in facts["tracks"]}
    return int(asked) if known else int(frames.get(track, facts["start"]))


def _addresses(seen: SeenScene, opened: OverlayFile) -> dict[str, Any]:
    return {"id": seen.score.scene_id, "digest": seen.digest, "state": seen.score.state.value}


def _records(source: Reader, score: SceneScore, rows: list[ListedScene]) -> list[SceneScore]:
    """Read the records of near neighbours that list a thing of the same kind and class.

    One that cannot be read is left out.
    """
    things = {(track.kind, track.class_name) for track in score.tracks if is_strong(score, track)}
    similar = [row for row in rows if any((t.kind, t.class_name) in things for t in row.tracks)]
    similar.sort(key=lambda row: abs(row.start_ns - score.start_ns))
    found = []
    for row in similar[:NEAREST]:
        try:
            found.append(source.scene(row.scene_id))
        except PermanentError:
            continue
    return found


def _block(request: Request, scene_id: str, digest: str, *, kind: str, number: int) -> Response:
    """Answer with a block; browsers undo zstd themselves where they ask for it.

    Over plain HTTP on another host Chromium does not ask, and fails when it is sent.
    """
    data = overlays_of(request).block(
        source_of(request), scene_id, digest, kind=kind, number=number
    )
    headers = {"vary": "accept-encoding"}
    if "zstd" in request.headers.get("accept-encoding", ""):
        headers["content-encoding"] = "zstd"
    return _kept(request, data, headers, media_type="application/octet-stream")


def _kept(
    request: Request,
    data: bytes,
    headers: Mapping[str, str],
    *,
    media_type: str,
    cache: str = IMMUTABLE,
) -> Response:
    """Answer with bytes that a browser keeps; with 304 where it has them."""
    etag = f'"{crc32(data):08x}{headers.get("content-encoding", "")}"'
    kept = {**headers, "etag": etag, "cache-control": cache}
    if request.headers.get("if-none-match") == etag:
        return Response(status_code=304, headers=kept)
    return Response(data, media_type=media_type, headers=kept)
