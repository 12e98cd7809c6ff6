"""Which streams the current scenes compare."""

from collections import Counter

from sqlalchemy import Connection, func, select

from schemas.score import SceneScore
from schemas.wire import decode
from service.status import Judged
from service.store.tables import SCENES


def judged(connection: Connection) -> tuple[Judged, ...]:
    """Name the pairs of streams, that of most current scenes first.

    A pipeline version names its streams once and for all: one record of each is opened.
    """
    c = SCENES.c
    groups = connection.execute(
        select(func.count().label("scenes"), func.min(c.scene_id).label("one"))
        .where(c.is_current)
        .group_by(c.pipeline_version)
    ).all()
    counts: Counter[tuple[str, str]] = Counter()
    for group in groups:
        query = select(c.record).where(c.is_current, c.scene_id == group.one)
        record = connection.execute(query).scalar_one()
        made_by = decode(SceneScore, bytes(record)).producers
        counts[made_by.supervised, made_by.selfsupervised] += group.scenes
    best_first = sorted(counts.items(), key=lambda each: (-each[1], each[0]))
    return tuple(
        Judged(supervised=supervised, selfsupervised=selfsupervised, scenes=scenes)
        for (supervised, selfsupervised), scenes in best_first
    )
