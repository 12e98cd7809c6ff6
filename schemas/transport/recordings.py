"""Grouping of bucket objects into recordings: a single MCAP file, or the parts of a split one."""

import re
from collections.abc import Iterable
from functools import lru_cache
from operator import itemgetter
from typing import Final

import structlog
from pydantic import ValidationError

from schemas.bounds import MAX_LOG_ID
from schemas.transport.bucket import ObjectMeta
from schemas.work import Part, Recording

log = structlog.get_logger(__name__)

EXTENSION: Final = ".mcap"
_SPLIT: Final = re.compile(r"(?P<name>.+)_(?P<number>0|[1-9][0-9]*)")


def group_recordings(objects: Iterable[ObjectMeta]) -> list[Recording]:
    """Group the MCAP files of a bucket into recordings.

    `_<n>` at the end of a name is a split number only where `_0` of that name exists and no unsplit
    file has the name itself; else every file is a recording of its own.

    Args:
        objects: Listed objects of the bucket; everything that is not `*.mcap` is ignored.

    Returns:
        Recordings in the order of their log ids, their parts in the order of their numbers. Those
        whose name or number of parts is beyond `schemas.bounds` are left out, and logged.
    """
    by_name = {
        found.key.removesuffix(EXTENSION): found
        for found in objects
        if found.key.endswith(EXTENSION) and not found.key.endswith("/" + EXTENSION)
    }
    grouped: dict[str, list[tuple[int, ObjectMeta]]] = {}
    for name, found in by_name.items():
        log_id, number = _split(name, by_name.keys())
        grouped.setdefault(log_id, []).append((number, found))
    recordings = (_recording(log_id, grouped[log_id]) for log_id in sorted(grouped))
    return [recording for recording in recordings if recording is not None]


def is_too_long(key: str) -> bool:
    """Return whether a key without its extension is longer than a log id may be."""
    return len(key.removesuffix(EXTENSION)) > MAX_LOG_ID


def recording_of(key: str, objects: Iterable[ObjectMeta]) -> Recording:
    """Find the whole recording that one of its parts belongs to.

    Args:
        key: Any part of it; it need not end in `.mcap` when it stands alone.
        objects: Objects of the same folder.

    Raises:
        LookupError: If there is no such object.
    """
    listed = list(objects)
    for recording in group_recordings(listed):
        if any(part.key == key for part in recording.parts):
            return recording
    for found in listed:
        if found.key == key:
            part = Part(key=key, size=found.size, etag=found.etag)
            return Recording(log_id=key, parts=(part,))
    raise LookupError(f"no such object in the bucket: {key}")


def _recording(log_id: str, numbered: Iterable[tuple[int, ObjectMeta]]) -> Recording | None:
    """Make a recording of its parts; log and omit one that exceeds the bounds of messages."""
    try:
        return Recording(
            log_id=log_id,
            parts=tuple(
                Part(key=found.key, size=found.size, etag=found.etag)
                for _, found in sorted(numbered, key=itemgetter(0))
            ),
        )
    except ValidationError as error:
        _say_left_out(log_id, error.errors(include_url=False)[0]["msg"])
        return None


@lru_cache(maxsize=1024)
def _say_left_out(log_id: str, problem: str) -> None:
    """Log a recording that is left out, once instead of at every listing."""
    log.warning("log left out: its name or its parts are too long", log_id=log_id, problem=problem)


def _split(name: str, names: Iterable[str]) -> tuple[str, int]:
    match = _SPLIT.fullmatch(name)
    if match is None or match["name"].endswith("/"):
        return name, 0
    if f"{match['name']}_0" not in names or match["name"] in names:
        return name, 0
    return match["name"], int(match["number"])
