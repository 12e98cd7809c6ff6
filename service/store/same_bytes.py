"""Recordings with the same bytes under several names: one is mined, the others refer to it.

Equal sizes and etags of all parts, in their order, are equal bytes: an etag is a digest of the
content, or names one version of one object. Where the mined name goes, the next one takes its place
and its finished scenes, which are named again from their overlays; no log is read for them.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, func, or_, select, update

from schemas.canonical import canonical_json
from schemas.work import Part, Recording
from service.errors import NothingFoundError
from service.store.events import withdraw
from service.store.leases import end_lease
from service.store.reused_shards import content_of, enter_again
from service.store.tables import LEASES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.turns import Kind, lane_of, turn_of
from service.store.work_items import OPEN, Work, WorkState, change

MAX_NAMED: Final = 20
"""Other names of a log that are named with its scenes; all are in the status."""

_AT_ONCE: Final = 500
"""Digests per statement; SQLite bounds its parameters."""


def content_digest(parts: Sequence[Part]) -> str:
    """Return the digest of what a listing knows of the bytes; empty where it knows nothing."""
    if not all(part.size and part.etag for part in parts):
        return ""
    known = canonical_json([[part.size, part.etag] for part in parts])
    return hashlib.sha256(known).hexdigest()[:16]


def fill_contents(connection: Connection) -> None:
    """Compute the digests of recordings that an earlier program listed."""
    for row in connection.execute(
        select(RECORDINGS.c.log_id, RECORDINGS.c.revision, RECORDINGS.c.recording)
    ).all():
        parts = Recording.model_validate_json(row.recording).parts
        connection.execute(
            update(RECORDINGS)
            .where(RECORDINGS.c.log_id == row.log_id, RECORDINGS.c.revision == row.revision)
            .values(content=content_digest(parts))
        )


def share_bytes(connection: Connection) -> None:
    """Choose the name that is mined of each group of current recordings with the same bytes.

    The one that is mined already stays; else the one that was listed first.
    """
    for group in _groups(connection):
        mined = min(group, key=lambda row: (bool(row.same_as), row.listed_s, row.log_id))
        for row in group:
            same_as = "" if row is mined else mined.log_id
            if same_as == row.same_as:
                continue
            connection.execute(update(RECORDINGS).where(_at(row)).values(same_as=same_as))
            if same_as and not row.same_as:
                _set_aside(connection, row)
            elif row.same_as and not same_as:
                _take_up(connection, row)


def take_scenes(connection: Connection, work: Work, *, content: str) -> None:
    """Have waiting shards of a new plan take over what another name of the same bytes has mined."""
    if not content:
        return
    others = connection.execute(
        select(RECORDINGS.c.log_id, RECORDINGS.c.revision, RECORDINGS.c.recording).where(
            RECORDINGS.c.content == content,
            RECORDINGS.c.content != "",  # the condition of the index
            RECORDINGS.c.log_id != work.log_id,
        )
    ).all()
    if not others:
        return
    own = connection.execute(
        select(RECORDINGS.c.recording).where(
            RECORDINGS.c.log_id == work.log_id, RECORDINGS.c.revision == work.revision
        )
    ).scalar_one()
    parts = Recording.model_validate_json(own).parts
    shards = connection.execute(
        select(SHARDS).where(_of(work.log_id, work.revision, work), _WAITS)
    ).all()
    for other in others:
        its_parts = Recording.model_validate_json(other.recording).parts
        done = {
            row.name: row
            for row in connection.execute(
                select(SHARDS).where(
                    _of(other.log_id, other.revision, work),
                    SHARDS.c.state == WorkState.DONE,
                    SHARDS.c.adopted_from == "",
                )
            )
        }
        left = []
        for shard in shards:
            mined = done.get(shard.name)
            if mined is None or not _is_same(shard, parts, mined, its_parts):
                left.append(shard)
                continue
            change(
                connection,
                Work(work.log_id, work.revision, work.pipeline_version, shard.name),
                rescored_from=work.pipeline_version,
                taken_from_log=other.log_id,
                taken_from_revision=other.revision,
                turn=turn_of(Kind.RESCORED, lane=lane_of(shard.turn)),
            )
        shards = left


def same_as(connection: Connection, log_id: str) -> str:
    """Return the log that is mined in place of this one; empty: it is mined itself."""
    found = connection.execute(
        select(RECORDINGS.c.same_as).where(RECORDINGS.c.log_id == log_id, RECORDINGS.c.is_current)
    ).scalar_one_or_none()
    return found or ""


def refuse_copy(connection: Connection, scene_id: str) -> None:
    """Check that a scene that was not found is of no log that another one is mined for.

    Raises:
        NothingFoundError: If it is; the sentence names the other log.
    """
    log_id = scene_id.rsplit("/", 2)[0]
    if mined := same_as(connection, log_id):
        raise NothingFoundError(
            f"no current scene {scene_id!r}: {log_id} has the same bytes as {mined}, which is "
            "mined for both; its scenes are those of that log"
        )


def copies(connection: Connection) -> dict[str, tuple[str, ...]]:
    """Return the logs that another one is mined for, in order, by that one."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for row in connection.execute(
        select(RECORDINGS.c.same_as, RECORDINGS.c.log_id)
        .where(RECORDINGS.c.same_as != "", RECORDINGS.c.is_current)
        .order_by(RECORDINGS.c.same_as, RECORDINGS.c.log_id)
    ):
        if len(found[row.same_as]) < MAX_NAMED:
            found[row.same_as].append(row.log_id)
    return {log_id: tuple(names) for log_id, names in found.items()}


def _groups(connection: Connection) -> Iterator[list[Row[Any]]]:
    """Yield current recordings with equal bytes, and those that have been such until now."""
    many = (
        select(RECORDINGS.c.content)
        .where(RECORDINGS.c.is_current, RECORDINGS.c.content != "")
        .group_by(RECORDINGS.c.content)
        .having(func.count() > 1)
    )
    single = select(RECORDINGS.c.content).where(RECORDINGS.c.is_current, RECORDINGS.c.same_as != "")
    contents = iter(sorted({row.content for row in connection.execute(many.union(single))}))
    while some := list(islice(contents, _AT_ONCE)):
        groups: defaultdict[str, list[Any]] = defaultdict(list)
        for row in connection.execute(
            select(*_FACTS).where(RECORDINGS.c.is_current, RECORDINGS.c.content.in_(some))
        ):
            groups[row.content].append(row)
        yield from groups.values()


def _set_aside(connection: Connection, row: Row[Any]) -> None:
    """End the work of a recording that another one is mined for, and withdraw its scenes."""
    held = select(LEASES.c.lease_id).where(
        LEASES.c.is_held, LEASES.c.log_id == row.log_id, LEASES.c.revision == row.revision
    )
    for lease_id in connection.execute(held).scalars().all():
        end_lease(connection, lease_id, by="replaced")
    for table in (PLANS, SHARDS):
        connection.execute(
            update(table)
            .where(
                table.c.log_id == row.log_id,
                table.c.revision == row.revision,
                table.c.state.in_((*OPEN, WorkState.KEPT)),
            )
            .values(state=WorkState.SAME, lease_id="")
        )
    withdraw(connection, SCENES.c.log_id == row.log_id, by="revision")


def _take_up(connection: Connection, row: Row[Any]) -> None:
    """Resume the work of a recording that is mined itself from now on, and restore its scenes."""
    for table in (PLANS, SHARDS):
        connection.execute(
            update(table)
            .where(
                table.c.log_id == row.log_id,
                table.c.revision == row.revision,
                table.c.state == WorkState.SAME,
            )
            .values(state=WorkState.READY, ready_at_s=0.0)
        )
    enter_again(connection, log_id=row.log_id, revision=row.revision)


def _is_same(
    shard: Row[Any], parts: Sequence[Part], mined: Row[Any], its_parts: Sequence[Part]
) -> bool:
    """Return true if two shards of two logs are the same but for the names in them."""
    one, other = content_of(shard.shard, parts), content_of(mined.shard, its_parts)
    return one is not None and other is not None and _unnamed(one) == _unnamed(other)


def _unnamed(content: dict[str, Any]) -> Any:
    """Return the content of a shard without log, vehicle and keys; parts are known by etags."""
    etag = {part.key: f"{position}/{part.size}/{part.etag}" for position, part in _parts(content)}
    plain = {name: value for name, value in content.items() if name not in _NAMES}
    text = json.dumps(plain | {"parts": list(etag.values())}, sort_keys=True)
    for key, known in etag.items():
        text = text.replace(json.dumps(key), json.dumps(known))
    return text


def _parts(content: dict[str, Any]) -> Iterable[tuple[int, Part]]:
    return enumerate(content["parts"])


_NAMES: Final = frozenset({"log_id", "vehicle", "date", "software_version", "parts"})
_FACTS: Final = (
    RECORDINGS.c.log_id,
    RECORDINGS.c.revision,
    RECORDINGS.c.content,
    RECORDINGS.c.same_as,
    RECORDINGS.c.listed_s,
)
_WAITS: Final = and_(
    or_(SHARDS.c.state == WorkState.READY, SHARDS.c.state == WorkState.STALE),
    SHARDS.c.rescored_from == "",
)


def _at(row: Row[Any]) -> Any:
    return and_(RECORDINGS.c.log_id == row.log_id, RECORDINGS.c.revision == row.revision)


def _of(log_id: str, revision: str, work: Work) -> Any:
    return and_(
        SHARDS.c.log_id == log_id,
        SHARDS.c.revision == revision,
        SHARDS.c.pipeline_version == work.pipeline_version,
    )
