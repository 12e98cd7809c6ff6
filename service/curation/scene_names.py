"""Short names of scenes: the end of the log id, and the start time. Pure.

`street-001@2026-03-02T09:01:04.0` is a scene of the one log whose id has this end.
"""

import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime

from service.curation.ranking import RankedScene
from service.errors import NothingFoundError, UsageError

_NAME = re.compile(r"(?P<log>.+)@(?P<begins>\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d)")


def short_names(rows: Sequence[RankedScene]) -> dict[str, str]:
    """Name scenes by the least number of last parts of their log ids that makes the logs distinct.

    Where two lidars of a log begin together, the lidar is part of the name.

    Args:
        rows: Scenes that are listed together.

    Returns:
        Short name of each, by scene id.
    """
    log_ids = {row.log_id for row in rows}
    ends = {log_id: _end_of(log_id, log_ids) for log_id in log_ids}
    names = {row.scene_id: f"{ends[row.log_id]}@{begins(row.start_ns)}" for row in rows}
    counts = Counter(names.values())
    return {
        row.scene_id: name
        if counts[name := names[row.scene_id]] == 1
        else f"{ends[row.log_id]}/{_lidar(row)}@{begins(row.start_ns)}"
        for row in rows
    }


def is_short_name(text: str) -> bool:
    """Return true if a text has the form of a short name."""
    return _NAME.fullmatch(text) is not None


def named(text: str, rows: Sequence[RankedScene]) -> RankedScene:
    """Find the scene of a short name.

    Args:
        text: Name that `short_names` made.
        rows: Every scene.

    Raises:
        NothingFoundError: If no scene has this name.
        UsageError: If several have it, since it comes from another listing where it was unique.
    """
    said = _NAME.fullmatch(text)
    if said is None:
        raise UsageError(f"{text!r} is no short name of a scene")
    found = [
        row
        for row in rows
        if begins(row.start_ns) == said["begins"]
        and any(
            f"/{known}".endswith(f"/{said['log']}")
            for known in (row.log_id, f"{row.log_id}/{_lidar(row)}")
        )
    ]
    found = [row for row in found if row.log_id == said["log"]] or found
    if not found:
        raise NothingFoundError(f"no current scene {text!r}; `counterpoint top` lists them")
    if len(found) > 1:
        listed = ", ".join(f"{row.rank} ({row.scene_id})" for row in found)
        raise UsageError(f"{text!r} matches several scenes, name one by its rank: {listed}")
    return found[0]


def begins(start_ns: int) -> str:
    """Return the start of a scene in UTC, rounded down to a tenth of a second."""
    moment = datetime.fromtimestamp(start_ns // 10**9, tz=UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{start_ns // 10**8 % 10}"


def _lidar(row: RankedScene) -> str:
    return row.scene_id.removeprefix(f"{row.log_id}/").rpartition("/")[0]


def _end_of(log_id: str, log_ids: set[str]) -> str:
    parts = log_id.split("/")
    for count in range(1, len(parts)):
        end = "/".join(parts[-count:])
        if sum(f"/{other}".endswith(f"/{end}") for other in log_ids) == 1:
            return end
    return log_id


def parse_short_name(text: str) -> tuple[str, int] | None:
    """Return the log's end and the begin, nanoseconds rounded down to a tenth of a second.

    None: the text is no short name.
    """
    said = _NAME.fullmatch(text)
    if said is None:
        return None
    try:
        moment = datetime.strptime(said["begins"], "%Y-%m-%dT%H:%M:%S.%f").replace(tzinfo=UTC)
    except ValueError:
        return None
    return said["log"], int(moment.timestamp()) * 10**9 + moment.microsecond * 1000
