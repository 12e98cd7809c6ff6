"""Static files of the pages, from memory: a scene page asks for some twenty at once."""

from dataclasses import dataclass
from mimetypes import guess_type
from pathlib import Path
from typing import Final
from zlib import crc32

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

_TYPES: Final = {".js": "text/javascript", ".mjs": "text/javascript"}
"""Types that the tables of some systems do not have, or have otherwise."""


@dataclass(frozen=True, slots=True)
class _Kept:
    """A file in memory.

    Attributes:
        version: Its time of change and size.
        data: Its bytes.
        headers: Headers of its answer.
    """

    version: tuple[int, int]
    data: bytes
    headers: dict[str, str]


class StaticFiles:
    """Answers with the files of a folder, and reads a file again when it has changed."""

    def __init__(self, folder: Path) -> None:
        """Keep the folder; its files are found once, so that no path leads out of it."""
        self._paths = {
            path.relative_to(folder).as_posix(): path
            for path in folder.rglob("*")
            if path.is_file()
        }
        self._kept: dict[str, _Kept] = {}

    async def answer(self, request: Request) -> Response:
        """Answer with the file of a path; with 304 where the browser has it.

        Raises:
            HTTPException: If there is no such file.
        """
        found = self._file(request.path_params["path"])
        if found is None:
            raise HTTPException(404)
        if request.headers.get("if-none-match") == found.headers["etag"]:
            return Response(status_code=304, headers=found.headers)
        return Response(found.data, headers=found.headers)

    def _file(self, name: str) -> _Kept | None:
        path = self._paths.get(name)
        try:
            if path is None or not path.is_file():
                return None
            about = path.stat()
            version = about.st_mtime_ns, about.st_size
            known = self._kept.get(name)
            if known is not None and known.version == version:
                return known
            data = path.read_bytes()
        except OSError:
            return None
        kind = _TYPES.get(path.suffix) or guess_type(name)[0] or "application/octet-stream"
        charset = "; charset=utf-8" if kind.startswith("text/") else ""
        headers = {"content-type": f"{kind}{charset}", "etag": f'"{crc32(data):08x}-{len(data)}"'}
        self._kept[name] = _Kept(version, data, headers)
        return self._kept[name]
