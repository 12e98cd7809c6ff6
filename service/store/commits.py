"""Idempotent commits: a finished plan or shard enters the ledger as a whole, exactly once."""

import hashlib
from functools import lru_cache
from typing import Any, Final

from sqlalchemy import Connection, Row, bindparam, insert, select, update

from schemas.canonical import canonical_json
from schemas.score import SceneScore
from schemas.work import Answer, CommitRequest, Damage, LogPlan, Shard
from service.store.events import insert_scenes
from service.store.lanes import Lanes
from service.store.leases import end_lease, lease_of, work_of
from service.store.manifest import Verified
from service.store.rescored_shards import mined_before
from service.store.reused_shards import enter_plan
from service.store.same_bytes import take_scenes
from service.store.statements import Statement
from service.store.supersede import give_way
from service.store.tables import DAMAGE, SCENES, SHARDS
from service.store.transaction_effects import effects_of, kind_of
from service.store.turns import in_lane
from service.store.work_items import TAKEN_AND_GIVEN, Work, WorkState, change, row_of

_END_OF_TIME_NS: Final = 2**63 - 1

_SCENES_AT_ONCE: Final = 500
"""Scenes per statement; SQLite bounds its parameters to 32,766, PostgreSQL to 65,535."""


def commit(
    connection: Connection,
    request: CommitRequest,
    verified: Verified,
    *,
    now_s: float,
    lanes: Lanes | None = None,
) -> Answer:
    """Finish the work of a lease, in the caller's transaction.

    The lease may have ended: a late result is accepted unless another worker was faster. A repeat
    after a lost answer is accepted as well.
    """
    effects, kind = effects_of(connection), kind_of("" if request.plan else "shard")
    before = effects.stored[kind]
    answer = _answer(connection, request, verified, now_s=now_s, lanes=lanes or Lanes())
    effects.note_commit(kind, answer, stored=effects.stored[kind] > before)
    return answer


def _answer(
    connection: Connection,
    request: CommitRequest,
    verified: Verified,
    *,
    now_s: float,
    lanes: Lanes,
) -> Answer:
    lease = lease_of(connection, request.lease_id, worker_id=request.worker_id)
    if isinstance(lease, str):
        return Answer(ok=False, problem=lease)
    work = work_of(lease)
    if (request.plan is None) == (work.shard == ""):
        sent = "a shard" if request.plan is None else "a plan"
        return Answer(ok=False, problem=f"commit of {sent}, but the lease is for {work}")
    if not lease.is_current:
        return Answer(
            ok=False, problem=f"recording was replaced or deleted meanwhile ({work.log_id})"
        )
    row = row_of(connection, work)
    if request.plan is not None:
        answer = _commit_plan(
            connection, work, row, request.plan, lanes=lanes, content=lease.content
        )
    else:
        answer = _commit_shard(connection, work, row, request, verified, now_s=now_s)
    if answer.ok and lease.is_held:
        end_lease(connection, lease.lease_id, by="committed")
    return answer


def _commit_plan(
    connection: Connection, work: Work, row: Row[Any], plan: LogPlan, *, lanes: Lanes, content: str
) -> Answer:
    problem = _problem_of(plan, work)
    if problem:
        return Answer(ok=False, problem=problem)
    # How much was read to make it may differ between two planners, what they found may not.
    found = plan.model_dump(mode="json", exclude={"range_reads", "bytes_read"})
    digest = hashlib.sha256(canonical_json(found)).hexdigest()
    if row.state in {WorkState.DONE, WorkState.REFUSED}:
        return _repeated(work, same=row.digest == digest)
    change(
        connection,
        work,
        state=WorkState.REFUSED if plan.refused else WorkState.DONE,
        error=plan.refused,
        lease_id="",
        vehicle=plan.vehicle,
        date=plan.date,
        software_version=plan.software_version,
        lidar_topics=canonical_json(plan.lidar_topics).decode(),
        digest=digest,
        range_reads=plan.range_reads,
        bytes_read=plan.bytes_read,
        truncated_parts=plan.truncated_parts,
    )
    if plan.shards and not plan.refused:
        turn = in_lane(row.turn, lanes.lane(work.log_id, plan.vehicle))
        _INSERT_SHARD.run_each(
            connection, [_shard_row(work, shard, turn=turn) for shard in plan.shards]
        )
    _store_damage(connection, work, plan.damage)
    enter_plan(connection, work)
    take_scenes(connection, work, content=content)
    effects_of(connection).stored["plan"] += 1
    return Answer(ok=True)


def _commit_shard(
    connection: Connection,
    work: Work,
    row: Row[Any],
    request: CommitRequest,
    verified: Verified,
    *,
    now_s: float,
) -> Answer:
    entries = [(entry.scene_id, entry.sha256) for entry in request.manifest]
    digest = hashlib.sha256(canonical_json(entries)).hexdigest()
    if row.state == WorkState.DONE:
        return _repeated(work, same=row.digest == digest)
    if verified.problem:
        return Answer(ok=False, problem=verified.problem)
    missing = tuple(scene_id for scene_id, _ in entries if scene_id not in verified.scenes)
    if missing:
        return Answer(ok=False, missing=missing)
    if row.digest:  # mined again for its overlays: its scenes are stored
        if row.digest == digest:
            change(connection, work, state=WorkState.DONE, error="", lease_id="", committed_s=now_s)
        return _repeated(work, same=row.digest == digest)
    scenes = [verified.scenes[scene_id] for scene_id, _ in entries]
    problem = _problem_of_scenes(connection, work, row, [score for score, _, _ in scenes])
    if problem:
        return Answer(ok=False, problem=problem)
    stats, mined_s = request.stats, sum(request.stats.stage_s.values())
    amount: dict[str, Any] = {"frames": stats.frames, "points": stats.points}
    if row.rescored_from:
        amount, mined_s = mined_before(connection, work, row), 0.0
    _FINISH_SHARD.rows(
        connection,
        {
            "at_log": work.log_id,
            "at_revision": work.revision,
            "at_pipeline": work.pipeline_version,
            "at_shard": work.shard,
            "digest": digest,
            "committed_s": now_s,
            **amount,
            "mined_s": mined_s,
            "bytes_read": stats.bytes_read,
            "bytes_needed": stats.bytes_needed,
            "range_reads": stats.range_reads,
            "peak_memory_bytes": stats.peak_memory_bytes,
            "stage_s": canonical_json(stats.stage_s).decode(),
        },
    )
    _store_damage(connection, work, request.damage)
    current = give_way(
        connection, work, row, {score.scene_id: score.start_ns for score, _, _ in scenes}
    )
    insert_scenes(connection, work, scenes, current=current)
    effects_of(connection).stored["shard"] += 1
    effects_of(connection).scenes += [score for score, _, _ in scenes]
    return Answer(ok=True)


def _repeated(work: Work, *, same: bool) -> Answer:
    if same:
        return Answer(ok=True)
    return Answer(
        ok=False,
        problem=f"{work} was committed before with other results, which are kept; "
        "mining it twice must give the same bytes",
    )


def _problem_of(plan: LogPlan, work: Work) -> str:
    names = [shard.name for shard in plan.shards]
    if plan.log_id != work.log_id or any(shard.log_id != work.log_id for shard in plan.shards):
        return f"plan is of another log: {plan.log_id} (lease is for {work})"
    if len(set(names)) != len(names):
        return f"plan names a shard twice ({work.log_id})"
    return ""


def _problem_of_scenes(
    connection: Connection, work: Work, row: Row[Any], scores: list[SceneScore]
) -> str:
    for score in scores:
        of = (score.log_id, score.lidar_topic, score.producers.pipeline_version)
        leased = (work.log_id, row.lidar_topic, work.pipeline_version)
        if of != leased:
            return f"scene {score.scene_id} is of {of}, but the lease is for {leased}"
    at = {
        "log": work.log_id,
        "revision": work.revision,
        "pipeline": work.pipeline_version,
    }
    for begin in range(0, len(scores), _SCENES_AT_ONCE):
        some = scores[begin : begin + _SCENES_AT_ONCE]
        ids = {f"scene_{i}": score.scene_id for i, score in enumerate(some)}
        taken = _taken(len(ids)).first(connection, at | ids)
        if taken is not None:
            return f"scene {taken.scene_id} was stored before, from shard {taken.shard}"
    return ""


def _shard_row(work: Work, shard: Shard, *, turn: int) -> dict[str, Any]:
    return {
        "log_id": work.log_id,
        "revision": work.revision,
        "pipeline_version": work.pipeline_version,
        "name": shard.name,
        "lidar_topic": shard.lidar.topic,
        "shard_index": shard.index,
        # The first and last shard of a log also answer for what older grids put beyond them.
        "covers_from_ns": 0 if shard.first_of_log else shard.start_ns,
        "covers_to_ns": _END_OF_TIME_NS if shard.last_of_log else shard.end_ns,
        "shard": shard.model_dump_json(),
        "state": WorkState.READY,
        "attempts": 0,
        "error": "",
        "ready_at_s": 0.0,
        "lease_id": "",
        "digest": "",
        "committed_s": 0.0,
        "frames": 0,
        "points": 0,
        "bytes_read": 0,
        "bytes_needed": 0,
        "range_reads": 0,
        "peak_memory_bytes": 0,
        "stage_s": "{}",
        "adopted_from": "",
        "turn": turn,
        "rescored_from": "",
        "mined_s": 0.0,
        "taken_from_log": "",
        "taken_from_revision": "",
    }


def _store_damage(connection: Connection, work: Work, damage: tuple[Damage, ...]) -> None:
    rows = [
        {
            "log_id": work.log_id,
            "revision": work.revision,
            "pipeline_version": work.pipeline_version,
            "shard": work.shard,
            "position": position,
            "object_key": piece.key,
            "byte_offset": piece.offset,
            "byte_count": piece.bytes,
            "what": piece.what,
        }
        for position, piece in enumerate(damage)
    ]
    if rows:
        connection.execute(insert(DAMAGE), rows)


_INSERT_SHARD: Final = Statement(insert(SHARDS))
_FINISH_SHARD: Final = Statement(
    update(SHARDS)
    .where(
        SHARDS.c.log_id == bindparam("at_log"),
        SHARDS.c.revision == bindparam("at_revision"),
        SHARDS.c.pipeline_version == bindparam("at_pipeline"),
        SHARDS.c.name == bindparam("at_shard"),
    )
    .values(
        state=WorkState.DONE.value,
        error="",
        lease_id="",
        mined_s=bindparam("mined_s"),
        **{name: bindparam(name) for name in TAKEN_AND_GIVEN},
    )
)


@lru_cache(maxsize=256)
def _taken(scenes: int) -> Statement:
    """Select the existing ones of so many scenes; all shards but a log's last have equally many.

    Args:
        scenes: At least 1, since an empty list is invalid SQL.
    """
    return Statement(
        select(SCENES.c.scene_id, SCENES.c.shard)
        .where(
            SCENES.c.log_id == bindparam("log"),
            SCENES.c.revision == bindparam("revision"),
            SCENES.c.pipeline_version == bindparam("pipeline"),
            SCENES.c.scene_id.in_([bindparam(f"scene_{i}") for i in range(scenes)]),
        )
        .limit(1)
    )
