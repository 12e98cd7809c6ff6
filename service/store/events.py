"""Events of scenes: each change of a current scene gets the next number, in commit order."""

from collections.abc import Collection, Iterator, Sequence
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Row, and_, bindparam, insert, select, update

from schemas.canonical import canonical_json
from schemas.score import SceneScore
from schemas.task import MOTION
from service.store.listed_scenes import ListedNow, list_scenes, list_stored, unlist
from service.store.statements import Statement
from service.store.tables import COUNTERS, SCENES
from service.store.work_items import Work


def reasons_as_stored(score: SceneScore) -> str:
    """Return the reasons of a record as its JSON has them."""
    return canonical_json([each.model_dump(mode="json") for each in score.reasons]).decode()


def insert_scenes(
    connection: Connection,
    work: Work,
    scenes: Sequence[tuple[SceneScore, bytes, str]],
    *,
    current: Collection[str],
) -> None:
    """Store mined scenes in the order given, with the next numbers.

    Args:
        connection: In a transaction that writes.
        work: Their shard.
        scenes: Score, record, digest of the record.
        current: Ids of those that become current; the others are history from the start.
    """
    following = _next_numbers(connection, sum(score.scene_id in current for score, _, _ in scenes))
    rows: list[dict[str, Any]] = []
    listed: list[ListedNow] = []
    for score, record, sha256 in scenes:
        is_current = score.scene_id in current
        seq, counts = next(following) if is_current else None, point_counts(score)
        if seq is not None:
            listed.append((seq, score, sha256, counts))
        rows.append(
            {
                "log_id": work.log_id,
                "revision": work.revision,
                "pipeline_version": work.pipeline_version,
                "scene_id": score.scene_id,
                "shard": work.shard,
                "seq": seq,
                "withdrawn_seq": None,
                "is_current": is_current,
                "withdrawn_by": "" if is_current else "pipeline",
                "lidar_topic": score.lidar_topic,
                "vehicle": score.vehicle,
                "date": score.date,
                "software_version": score.software_version,
                "start_ns": score.start_ns,
                "end_ns": score.end_ns,
                "frames": score.frames,
                "state": score.state.value,
                "score": score.score,
                "reasons": reasons_as_stored(score),
                **counts,
                "record": record,
                "sha256": sha256,
            }
        )
    if rows:
        _INSERT_SCENE.run_each(connection, rows)
    list_scenes(connection, listed)


def withdraw(
    connection: Connection,
    which: ColumnElement[bool],
    *,
    by: str,
    replaced: Collection[str] = (),
) -> None:
    """Withdraw current scenes.

    Args:
        connection: In a transaction that writes.
        which: Condition on `SCENES`.
        by: Cause: `revision` (the recording was replaced or deleted), `pipeline` (mined again).
        replaced: Ids that the same transaction stores again: their key gets the new record, so the
            withdrawal needs no event of its own.
    """
    going = connection.execute(
        select(*_KEY, SCENES.c.seq).where(SCENES.c.is_current, which).order_by(SCENES.c.seq)
    ).all()
    following = _next_numbers(connection, sum(row.scene_id not in replaced for row in going))
    withdrawn = [
        {
            **_key_of(row),
            "by": by,
            "number": None if row.scene_id in replaced else next(following),
        }
        for row in going
    ]
    if withdrawn:
        connection.execute(_WITHDRAW, withdrawn)
    unlist(connection, [row.seq for row in going])


def restore(connection: Connection, which: ColumnElement[bool]) -> None:
    """Make scenes current again.

    Args:
        connection: In a transaction that writes.
        which: Condition on `SCENES`; none of them is current now.
    """
    returning = connection.execute(
        select(*_KEY).where(which).order_by(SCENES.c.lidar_topic, SCENES.c.start_ns)
    ).all()
    following = _next_numbers(connection, len(returning))
    restored = [{**_key_of(row), "number": next(following)} for row in returning]
    if restored:
        connection.execute(_RESTORE, restored)
    list_stored(connection, [row["number"] for row in restored])


def _key_of(row: Row[*tuple[Any, ...]]) -> dict[str, Any]:
    return {f"at_{column.name}": row._mapping[column] for column in _KEY}


def mark_published(connection: Connection, seq: int) -> None:
    """Move the outbox's cursor forward, never back."""
    connection.execute(
        update(COUNTERS)
        .where(COUNTERS.c.name == "published", COUNTERS.c.value < seq)
        .values(value=seq)
    )


def counter(connection: Connection, name: str) -> int:
    """Read a counter: `seq`, `published` or `selection`."""
    return int(
        connection.execute(select(COUNTERS.c.value).where(COUNTERS.c.name == name)).scalar_one()
    )


def _next_numbers(connection: Connection, count: int) -> Iterator[int]:
    """Reserve event numbers; the row stays locked until the commit, so they are in its order."""
    if count == 0:
        return iter(())
    last: int = _COUNT_ON.one(connection, {"more": count}).value
    return iter(range(last - count + 1, last + 1))


_INSERT_SCENE: Final = Statement(insert(SCENES))
_COUNT_ON: Final = Statement(
    update(COUNTERS)
    .where(COUNTERS.c.name == "seq")
    .values(value=COUNTERS.c.value + bindparam("more"))
    .returning(COUNTERS.c.value)
)


def point_counts(score: SceneScore) -> dict[str, int]:
    """Return points by agreement, from the shares of the record, exact to its rounding."""
    compared = score.points * score.compared_share
    shares = score.all_points
    counts = {outcome.name: round(compared * shares[outcome.name]) for outcome in MOTION.compared()}
    return {**counts, "not_compared": max(0, score.points - sum(counts.values()))}


_KEY: Final = (SCENES.c.log_id, SCENES.c.revision, SCENES.c.pipeline_version, SCENES.c.scene_id)
_AT: Final = and_(*(column == bindparam(f"at_{column.name}") for column in _KEY))
_WITHDRAW: Final = (
    update(SCENES)
    .where(_AT)
    .values(is_current=False, withdrawn_by=bindparam("by"), withdrawn_seq=bindparam("number"))
)
_RESTORE: Final = (
    update(SCENES)
    .where(_AT)
    .values(is_current=True, withdrawn_by="", withdrawn_seq=None, seq=bindparam("number"))
)
