"""Reuse of shards that another revision of a log has mined from the same bytes."""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, insert, literal, select

from schemas.work import Part, Recording
from service.store.revisions import take_over
from service.store.tables import DAMAGE, PLANS, RECORDINGS, SHARDS
from service.store.work_items import TAKEN_AND_GIVEN, Work, WorkState, change


def enter_plan(connection: Connection, work: Work) -> None:
    """Make the scenes of a newly planned revision current.

    Shards that other revisions mined from the same bytes are adopted; their other scenes are
    withdrawn.
    """
    if _other_revisions(connection, work):
        _adopt(connection, work)
        take_over(connection, log_id=work.log_id, revision=work.revision)


def enter_again(connection: Connection, *, log_id: str, revision: str) -> None:
    """Make the scenes of a returned revision current again, if it had been planned."""
    plans = connection.execute(
        select(PLANS.c.pipeline_version, PLANS.c.state).where(
            PLANS.c.log_id == log_id, PLANS.c.revision == revision
        )
    ).all()
    for plan in plans:
        if plan.state == WorkState.DONE:
            _adopt(connection, Work(log_id, revision, plan.pipeline_version))
    if any(plan.state in _ENDED for plan in plans):
        take_over(connection, log_id=log_id, revision=revision)


_ENDED: Final = (WorkState.DONE, WorkState.REFUSED, WorkState.PARKED)


def _other_revisions(connection: Connection, work: Work) -> bool:
    others = select(RECORDINGS.c.revision).where(
        RECORDINGS.c.log_id == work.log_id, RECORDINGS.c.revision != work.revision
    )
    return connection.execute(others.limit(1)).one_or_none() is not None


def _adopt(connection: Connection, work: Work) -> None:
    """Mark shards as done that another revision mined from the same bytes and version."""
    for shard, mined in list(_same_shards(connection, work)):
        adopted = Work(work.log_id, work.revision, work.pipeline_version, shard.name)
        kept = {name: mined._mapping[name] for name in TAKEN_AND_GIVEN}
        change(
            connection,
            adopted,
            state=WorkState.DONE,
            error="",
            lease_id="",
            adopted_from=mined.revision,
            **kept,
        )
        _copy_damage(connection, adopted, revision=mined.revision)


def _same_shards(connection: Connection, work: Work) -> Iterator[tuple[Row[Any], Row[Any]]]:
    """Yield pairs of a waiting shard and one of the same content, done by another revision."""
    its = and_(SHARDS.c.log_id == work.log_id, SHARDS.c.pipeline_version == work.pipeline_version)
    done: defaultdict[str, list[Row[Any]]] = defaultdict(list)
    for row in connection.execute(
        select(SHARDS)
        .where(
            its,
            SHARDS.c.revision != work.revision,
            SHARDS.c.state == WorkState.DONE,
            SHARDS.c.adopted_from == "",
        )
        .order_by(SHARDS.c.revision)
    ):
        done[row.name].append(row)
    if not done:
        return
    parts = {
        row.revision: Recording.model_validate_json(row.recording).parts
        for row in connection.execute(
            select(RECORDINGS.c.revision, RECORDINGS.c.recording).where(
                RECORDINGS.c.log_id == work.log_id
            )
        )
    }
    waiting = connection.execute(
        select(SHARDS)
        .where(its, SHARDS.c.revision == work.revision, SHARDS.c.state != WorkState.DONE)
        .order_by(SHARDS.c.lidar_topic, SHARDS.c.shard_index)
    ).all()
    for shard in waiting:
        content = content_of(shard.shard, parts[work.revision])
        for mined in done[shard.name]:
            if content is not None and content == content_of(mined.shard, parts[mined.revision]):
                yield shard, mined
                break


def content_of(shard: str, parts: Sequence[Part]) -> dict[str, Any] | None:
    """Return all that mining a shard depends on, independent of other parts of the recording.

    Parts are named by key, size and etag instead of counted. Of a channel's ids only those in parts
    that the shard reads are included. None for a shard that reads nothing.
    """
    # Not as a `Shard`: to check what was checked before it was stored takes most of the time.
    content: dict[str, Any] = json.loads(shard)
    read = {ref["part"]: parts[ref["part"]] for ref in content["chunks"]}
    for ref in content["chunks"]:
        ref["part"] = read[ref["part"]].key
    for channel in (content["lidar"], (content["recorded"] or {}).get("channel")):
        if channel is not None:
            channel["ids"] = sorted(
                (read[at].key, each) for at, each in channel["ids"] if at in read
            )
    return content | {"parts": sorted(read.values(), key=lambda part: part.key)} if read else None


def _copy_damage(connection: Connection, work: Work, *, revision: str) -> None:
    columns = [column for column in DAMAGE.c if column.name != "revision"]
    connection.execute(
        insert(DAMAGE).from_select(
            ["revision", *(column.name for column in columns)],
            select(literal(work.revision), *columns).where(
                DAMAGE.c.log_id == work.log_id,
                DAMAGE.c.revision == revision,
                DAMAGE.c.pipeline_version == work.pipeline_version,
                DAMAGE.c.shard == work.shard,
            ),
        )
    )
