"""Thumbnails of the ranking, drawn when they are first looked at and kept within a bound."""

import io
import threading
from collections import OrderedDict
from typing import Annotated, Final, cast

import structlog
from fastapi import APIRouter, Query
from PIL import Image
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
        self._places = threading.BoundedSemaphore(MOST_AT_A_TIME)

    def of(self, source: Reader, scene_id: str, digest: str) -> bytes:
        """Return the PNG of a scene; draw it if it is not kept.

        Raises:
            PermanentError: If the scene, or its overlay, is gone or cannot be read.
        """
        key = (scene_id, digest)
        with self._lock:
            if (known := self._kept.get(key)) is not None:
                self._kept.move_to_end(key)
                return known
        with self._places:
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
def thumbnail(
    request: Request, scene_id: Annotated[str, Query(alias="id")] = "", digest: str = ""
) -> Response:
    """Answer with the thumbnail of a scene; one whose overlay is gone says so."""
    kept = cast(Thumbnails, request.app.state.thumbnails)
    try:
        made = kept.of(source_of(request), scene_id, digest)
    except PermanentError as error:
        log.info("no thumbnail", scene_id=scene_id, problem=str(error))
        words = NO_OVERLAY if isinstance(error, NothingFoundError) else UNREADABLE
        return Response(png_of(draw_placeholder(words)), media_type="image/png")
    # Another digest is another address, so that browsers may keep what they have.
    headers = {"cache-control": "private, max-age=604800, immutable"} if digest else {}
    return Response(made, media_type="image/png", headers=headers)
