"""Mining speed measured in this ledger, for estimates."""

import json
from dataclasses import dataclass

from sqlalchemy import Connection, func, select

from service.store.overview import newest_pipeline
from service.store.tables import SHARDS
from service.store.work_items import WorkState

MOST_SHARDS = 1000
"""Newest shards that are read; they are enough, and reading them takes milliseconds."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Mining speed of one worker.

    Attributes:
        frames: Frames scored in the shards that were read.
        seconds_per_frame: Time of all stages over the scored frames; it includes the warm-up before
            a window and waits for the bucket.
        bytes_per_frame: Bytes read from the bucket over the scored frames.
        points_per_frame: Mean number of points of a frame.
    """

    frames: int
    seconds_per_frame: float
    bytes_per_frame: float = 0.0
    points_per_frame: float = 0.0


def pace(connection: Connection) -> Pace | None:
    """Measure the newest shards of the newest pipeline version; None when none is mined."""
    rows = connection.execute(
        select(SHARDS.c.frames, SHARDS.c.points, SHARDS.c.bytes_read, SHARDS.c.stage_s)
        .where(
            SHARDS.c.pipeline_version == newest_pipeline(connection),
            SHARDS.c.state == WorkState.DONE,
            SHARDS.c.frames > 0,
            SHARDS.c.rescored_from == "",
            func.length(SHARDS.c.stage_s) > len("{}"),
        )
        .order_by(SHARDS.c.committed_s.desc())
        .limit(MOST_SHARDS)
    ).all()
    frames = sum(row.frames for row in rows)
    if not frames:
        return None
    seconds = sum(sum(json.loads(row.stage_s).values()) for row in rows)
    return Pace(
        frames=frames,
        seconds_per_frame=seconds / frames,
        bytes_per_frame=sum(row.bytes_read for row in rows) / frames,
        points_per_frame=sum(row.points for row in rows) / frames,
    )
