"""Overlays that the page has open: their headers, and their blocks in stored form."""

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

from schemas.canonical import sha256
from schemas.errors import ObjectChangedError, PermanentError
from schemas.score import SceneScore
from schemas.transport.overlay_file import OverlayFile
from schemas.transport.wire import decode
from service.api.reader import Reader
from service.errors import NothingFoundError

MAX_OPEN_BYTES: Final = 256 * 2**20
"""Bytes of the overlays that one process keeps open. Those of a state folder are read by ranges
and take less; those of a service, and of version 1, lie in memory.
"""

CHANGED: Final = "this scene was mined again since the page was opened: load the page again"


@dataclass(frozen=True, slots=True)
class SeenScene:
    """The shown record of a scene.

    Attributes:
        score: The record.
        record: Its bytes as published.
        digest: Digest of these bytes, to which verdicts belong.
    """

    score: SceneScore
    record: bytes
    digest: str


def seen_scene(source: Reader, scene_id: str) -> SeenScene:
    """Read a scene, or the last record of one that is withdrawn.

    Raises:
        NothingFoundError: If there was never such a scene.
    """
    record = source.record(scene_id)
    return SeenScene(decode(SceneScore, record), record, sha256(record))


class OpenOverlays:
    """Open overlays by scene and digest; the least recently used ones are closed first."""

    def __init__(self, *, max_bytes: int = MAX_OPEN_BYTES) -> None:
        """Keep no more than these bytes, and one overlay in any case."""
        self._kept: OrderedDict[tuple[str, str], OverlayFile] = OrderedDict()
        self._max_bytes, self._lock = max_bytes, threading.Lock()
        self._opening = threading.Lock()

    def of(self, source: Reader, scene_id: str, digest: str) -> OverlayFile:
        """Return the overlay of the record with this digest; open it if it is not kept.

        Raises:
            NothingFoundError: If the scene has another record now, or no overlay.
            PackUnreadableError: If the overlay is damaged, or of a newer version.
        """
        key = (scene_id, digest)
        if known := self._known(key):
            return known
        with self._opening:
            if known := self._known(key):
                return known
            if digest != seen_scene(source, scene_id).digest:
                raise NothingFoundError(CHANGED)
            opened = source.overlay_file(scene_id)
            if opened.header.scene_id != scene_id:
                raise PermanentError(
                    f"the overlay is of scene {opened.header.scene_id}, not of {scene_id}"
                )
            self._keep(key, opened)
        return opened

    def block(self, source: Reader, scene_id: str, digest: str, *, kind: str, number: int) -> bytes:
        """Return one block as stored: `view` or `rest` of a frame, or a `picture`.

        Raises:
            NothingFoundError: If there is no such block, or the overlay is gone or replaced.
            PackUnreadableError: If it is damaged.
        """
        opened = self.of(source, scene_id, digest)
        count = len(opened.header.pictures if kind == "picture" else opened.header.frames)
        if not 0 <= number < count:
            raise NothingFoundError(f"no {kind} {number}: this scene has {count}, from 0 on")
        try:
            return bytes(getattr(opened, kind)(number))
        except ObjectChangedError:
            with self._lock:
                self._kept.pop((scene_id, digest), None)
            raise NothingFoundError(
                "the overlay of this scene was replaced or deleted: load the page again"
            ) from None

    def _known(self, key: tuple[str, str]) -> OverlayFile | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def _keep(self, key: tuple[str, str], opened: OverlayFile) -> None:
        with self._lock:
            self._kept[key] = opened
            while len(self._kept) > 1 and self._open_bytes() > self._max_bytes:
                self._kept.popitem(last=False)

    def _open_bytes(self) -> int:
        return sum(map(_bytes_of, self._kept.values()))


def _bytes_of(opened: OverlayFile) -> int:
    return max(offset + length for offset, length in opened.header.blocks())
