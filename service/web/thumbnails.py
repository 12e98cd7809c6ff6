"""Thumbnails of the ranking, drawn when they are first looked at and kept within a bound."""

import asyncio
import io
import threading
from collections import OrderedDict
from typing import Annotated, Final, cast

import structlog
from fastapi import APIRouter, Query
from PIL import Image
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from schemas.errors import PermanentError
from service.api.reader import Reader, overlay_of
from service.errors import NothingFoundError
from service.pictures.thumbnail import draw_placeholder, draw_thumbnail
from service.web.context import source_of

log = structlog.get_logger(__name__)

router = APIRouter()

MAX_KEPT_BYTES: Final = 64 * 2**20
"""Bytes of thumbnails that one process keeps; about 5,000 of them."""

MOST_AT_A_TIME: Final = 2
"""Thumbnails that are drawn at a time; each decodes an overlay into about 100 MB."""

NO_OVERLAY: Final = "no overlay"
UNREADABLE: Final = "overlay unreadable"

_COLOURS: Final = 64


class Thumbnails:
    """Thumbnails by scene and digest, the least recently used ones dropped first."""

    def __init__(self, *, max_bytes: int = MAX_KEPT_BYTES) -> None:
        """Keep no more than these bytes."""
        self._kept: OrderedDict[tuple[str, str], bytes] = OrderedDict()
        self._max_bytes, self._bytes = max_bytes, 0
        self._lock = threading.Lock()
        self.places = asyncio.Semaphore(MOST_AT_A_TIME)

    def kept(self, scene_id: str, digest: str) -> bytes | None:
        """Return the PNG of a scene if it is kept."""
        with self._lock:
            known = self._kept.get((scene_id, digest))
            if known is not None:
                self._kept.move_to_end((scene_id, digest))
            return known

    def drawn(self, source: Reader, scene_id: str, digest: str) -> bytes:
        """Draw the PNG of a scene, and keep it.

        Raises:
            PermanentError: If the scene, or its overlay, is gone or cannot be read.
        """
        key = (scene_id, digest)
        score = source.scene(scene_id)
        made = png_of(draw_thumbnail(score, overlay_of(source, scene_id)))
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._bytes += len(made)
            while self._bytes > self._max_bytes:
                _, dropped = self._kept.popitem(last=False)
                self._bytes -= len(dropped)
        return made


def png_of(image: Image.Image) -> bytes:
    """Encode a picture of few colours."""
    file = io.BytesIO()
    image.quantize(_COLOURS, dither=Image.Dither.NONE).save(file, "PNG")
    return file.getvalue()


@router.get("/thumb.png")
async def thumbnail(
    request: Request, scene_id: Annotated[str, Query(alias="id")] = "", digest: str = ""
) -> Response:
    """Answer with the thumbnail of a scene; one whose overlay is gone says so.

    Requests that wait for their turn take no thread, and those that were given up are not drawn.
    """
    thumbnails = cast(Thumbnails, request.app.state.thumbnails)
    try:
        made = thumbnails.kept(scene_id, digest)
        if made is None:
            async with thumbnails.places:
                if await request.is_disconnected():
                    return Response(status_code=503)
                source = source_of(request)
                made = thumbnails.kept(scene_id, digest) or await run_in_threadpool(
                    thumbnails.drawn, source, scene_id, digest
                )
    except PermanentError as error:
        log.info("no thumbnail", scene_id=scene_id, problem=str(error))
        words = NO_OVERLAY if isinstance(error, NothingFoundError) else UNREADABLE
        return Response(png_of(draw_placeholder(words)), media_type="image/png")
    # Another digest is another address, so that browsers may keep what they have.
    headers = {"cache-control": "private, max-age=604800, immutable"} if digest else {}
    return Response(made, media_type="image/png", headers=headers)
