"""Pairs of streams that the current scenes compare."""

from collections import Counter
from typing import Final

from sqlalchemy import Connection, func, select

from schemas.score import SceneScore
from schemas.transport.wire import decode
from service.curation.status import Judged
from service.store.record_digests import problem_of
from service.store.tables import SCENES


def judged(connection: Connection) -> tuple[Judged, ...]:
    """Return the pairs of streams, that of most current scenes first.

    A pipeline version has one pair of streams, so one undamaged record of each is decoded.
    """
    c = SCENES.c
    groups = connection.execute(
        select(c.pipeline_version, func.count().label("scenes"), func.min(c.scene_id).label("one"))
        .where(c.is_current)
        .group_by(c.pipeline_version)
    ).all()
    counts: Counter[tuple[str, str]] = Counter()
    for group in groups:
        record = _sound_record(connection, group.pipeline_version, first=group.one)
        if record:
            made_by = decode(SceneScore, record).producers
            counts[made_by.supervised, made_by.selfsupervised] += group.scenes
    best_first = sorted(counts.items(), key=lambda each: (-each[1], each[0]))
    return tuple(
        Judged(supervised=supervised, selfsupervised=selfsupervised, scenes=scenes)
        for (supervised, selfsupervised), scenes in best_first
    )


_TRIED: Final = 100
"""Records that are tried to find an undamaged one."""


def _sound_record(connection: Connection, pipeline_version: str, *, first: str) -> bytes:
    """Read one undamaged record of a pipeline version; empty if all that were tried are damaged."""
    c = SCENES.c
    columns = (c.scene_id, c.record, c.sha256)
    one = select(*columns).where(c.is_current, c.scene_id == first)
    others = select(*columns).where(c.is_current, c.pipeline_version == pipeline_version)
    for query in (one, others.limit(_TRIED)):
        for row in connection.execute(query):
            if not problem_of(row):
                return bytes(row.record)
    return b""
