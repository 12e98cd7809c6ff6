"""A small bucket and its miners, made of messages alone: what tests of the ledger drive it with."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from schemas.arrays import NS_PER_S
from schemas.canonical import sha256
from schemas.contradiction import SceneState, TrackRecord
from schemas.frame import OdometryState
from schemas.score import AgreementShares, OdometryHealth, Producers, Reason, SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.work import (
    Answer,
    Channel,
    ChunkRef,
    ClaimRequest,
    CommitRequest,
    Damage,
    FailRequest,
    LogPlan,
    ManifestEntry,
    MineLease,
    MiningStats,
    NothingToDo,
    Part,
    PlanLease,
    Recording,
    Shard,
)
from service.store import recordings
from service.store.engine import Store
from service.store.ledger import LeasePolicy, Ledger
from tests.factories import track_record

SCENES_PER_SHARD = 3
START_NS = 1_700_000_000 * NS_PER_S


class Clock:
    """Seconds that pass when the test says so."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0

    def __call__(self) -> float:
        return self.now_s


def recording(log_id: str, *, etag: str = "a") -> Recording:
    return Recording(
        log_id=log_id, parts=(Part(key=f"{log_id}.mcap", size=100, etag=f"{log_id}-{etag}"),)
    )


def split(log_id: str, *etags: str) -> Recording:
    """A recording in parts, which are known by their etags."""
    parts = (
        Part(key=f"{log_id}_{number}.mcap", size=100, etag=etag)
        for number, etag in enumerate(etags)
    )
    return Recording(log_id=log_id, parts=tuple(parts))


def plan_of_parts(recording: Recording) -> LogPlan:
    """A plan with one shard for each part; the last one knows that it is the last."""
    count = len(recording.parts)
    shards = [shard_of(recording.log_id, number, of=count) for number in range(count)]
    plan = plan_of(recording.log_id)
    return plan.model_copy(
        update={
            "shards": tuple(
                shard.model_copy(
                    update={
                        "lidar": shard.lidar.model_copy(
                            update={"ids": tuple((part, part + 1) for part in range(count))}
                        ),
                        "chunks": (
                            ChunkRef(
                                part=shard.index,
                                offset=64,
                                length=100,
                                start_ns=shard.start_ns,
                                end_ns=shard.end_ns,
                            ),
                        ),
                    }
                )
                for shard in shards
            )
        }
    )


def shard_of(log_id: str, index: int, *, of: int, topic: str = "/lidar", cells: int = 3) -> Shard:
    start_ns = START_NS + index * cells * 2 * NS_PER_S
    end_ns = start_ns + cells * 2 * NS_PER_S
    return Shard(
        log_id=log_id,
        index=index,
        lidar=Channel(
            topic=topic,
            message_encoding="cdr",
            schema_name="sensor_msgs/msg/PointCloud2",
            schema_encoding="ros2msg",
            schema_base64="",
            ids=((0, 1),),
        ),
        anchor_ns=START_NS,
        warmup_start_ns=start_ns,
        start_ns=start_ns,
        end_ns=end_ns,
        lookahead_end_ns=end_ns,
        first_of_log=index == 0,
        last_of_log=index == of - 1,
        chunks=(),
        needed_bytes=1000,
    )


def plan_of(log_id: str, *, shards: int = 3, cells: int = 3, refused: str = "") -> LogPlan:
    count = 0 if refused else shards
    return LogPlan(
        log_id=log_id,
        vehicle="bus-7",
        lidar_topics=("/lidar",),
        shards=tuple(shard_of(log_id, index, of=count, cells=cells) for index in range(count)),
        damage=(
            Damage(key=f"{log_id}.mcap", offset=64, bytes=8, what="chunk does not decompress"),
        ),
        refused=refused,
        range_reads=2,
        bytes_read=4096,
    )


def score_of(
    log_id: str,
    start_ns: int,
    *,
    score: float | None = None,
    topic: str = "/lidar",
    pipeline_version: str = "p1",
    duration_s: float = 1.9,
    state: SceneState = SceneState.SCORED,
    reasons: tuple[str, ...] = ("pedestrian only semantic",),
) -> SceneScore:
    lidar = topic.strip("/").replace("/", ".")
    scene_id = f"{log_id}/{lidar}/{start_ns}"
    if score is None:  # some number that is the same in every run
        score = hashlib.sha256(scene_id.encode()).digest()[0] / 255
    shares = AgreementShares(
        both_static=0.9, both_dynamic=0.05, only_semantic_dynamic=0.05, only_predictive_dynamic=0.0
    )
    return SceneScore(
        scene_id=scene_id,
        log_id=log_id,
        lidar_topic=topic,
        vehicle="bus-7",
        date="unknown",
        software_version="unknown",
        start_ns=start_ns,
        end_ns=start_ns + int(duration_s * NS_PER_S),
        frames=20,
        state=state,
        score=score,
        reasons=tuple(Reason(headline=each) for each in reasons),
        points=1000,
        compared_share=0.8,
        all_points=shares,
        nonground_points=shares,
        totals=(),
        tracks=(_parked_car(score, start_ns, int(duration_s * NS_PER_S)),),
        odometry=OdometryHealth(
            state=OdometryState.HEALTHY, healthy_share=1.0, static_residual_m=0.1, distance_m=5.0
        ),
        producers=Producers(
            supervised="s@1", selfsupervised="r@1", pipeline_version=pipeline_version
        ),
    )


def _parked_car(strength: float, start_ns: int, duration_ns: int) -> TrackRecord:
    """The same car in every scene, throughout and at the same place."""
    return track_record(
        strength=strength,
        first_ns=start_ns,
        last_ns=start_ns + duration_ns,
        speed_m_per_s=0.0,
        first_odom_m=(10.0, 0.0, 0.0),
        last_odom_m=(10.0, 0.0, 0.0),
    )


def mined(
    shard: Shard, recording: Recording | None = None, *, pipeline_version: str = "p1"
) -> dict[str, bytes]:
    """Digest to record of every scene of a shard, in order; the same whenever it is mined.

    Where a recording is given, the scores depend on the parts that the shard reads.
    """
    starts = range(shard.start_ns, shard.end_ns, 2 * NS_PER_S)
    read = [recording.parts[ref.part].etag for ref in shard.chunks] if recording else []
    content = hashlib.sha256("/".join(read).encode()).digest()[0] / 255 if read else None
    scores = [
        score_of(
            shard.log_id,
            start,
            score=content,
            topic=shard.lidar.topic,
            pipeline_version=pipeline_version,
        )
        for start in starts
    ]
    records = [encode_scene_score(score) for score in scores]
    return {sha256(record): record for record in records}


def manifest_of(records: dict[str, bytes]) -> tuple[ManifestEntry, ...]:
    return tuple(
        ManifestEntry(scene_id=SceneScore.model_validate_json(record).scene_id, sha256=digest)
        for digest, record in records.items()
    )


@dataclass
class World:
    """A ledger, its clock, and what tests do with it again and again."""

    store: Store
    clock: Clock
    ledger: Ledger
    planner: Callable[[Recording], LogPlan] = lambda recording: plan_of(recording.log_id)

    @classmethod
    def on(
        cls,
        store: Store,
        *,
        clock: Clock | None = None,
        plan_ahead: int = 16,
        settle_s: float = 0.0,
        planner: Callable[[Recording], LogPlan] | None = None,
    ) -> "World":
        clock = clock or Clock()
        policy = LeasePolicy(plan_ahead=plan_ahead, settle_s=settle_s)
        ledger = Ledger(store, now_s=clock, policy=policy)
        return cls(store, clock, ledger, planner) if planner else cls(store, clock, ledger)

    def listed(self, *log_ids: str, etag: str = "a") -> None:
        self.ledger.sync_recordings([recording(log_id, etag=etag) for log_id in log_ids])

    def register_pipeline(self, version: str) -> None:
        """Make a pipeline version the newest, as the first claim of one of its workers does."""
        with self.store.writing() as connection:
            recordings.register_pipeline(connection, version)

    def claim(self, worker: str = "w1", version: str = "p1") -> PlanLease | MineLease | NothingToDo:
        request = ClaimRequest(worker_id=worker, pipeline_version=version)
        return self.ledger.claim(request).grant

    def plan_lease(self, worker: str = "w1", version: str = "p1") -> PlanLease:
        grant = self.claim(worker, version)
        assert isinstance(grant, PlanLease), grant
        return grant

    def mine_lease(self, worker: str = "w1", version: str = "p1") -> MineLease:
        grant = self.claim(worker, version)
        assert isinstance(grant, MineLease), grant
        return grant

    def commit_plan(
        self, lease: PlanLease, worker: str = "w1", plan: LogPlan | None = None
    ) -> Answer:
        plan = plan or self.planner(lease.recording)
        request = CommitRequest(worker_id=worker, lease_id=lease.lease_id, plan=plan)
        return self.ledger.commit(request, {})

    def commit_shard(self, lease: MineLease, worker: str = "w1", version: str = "p1") -> Answer:
        records = mined(lease.shard, lease.recording, pipeline_version=version)
        return self.ledger.commit(shard_commit(lease, records, worker=worker), records)

    def fail(self, lease: PlanLease | MineLease, worker: str = "w1", **how: bool) -> Answer:
        how.setdefault("permanent", False)
        request = FailRequest(
            worker_id=worker, lease_id=lease.lease_id, error="cannot read chunk", **how
        )
        return self.ledger.fail(request)

    def plan_all(self, version: str = "p1") -> None:
        """Plan until a shard comes, and give that back."""
        while isinstance(grant := self.claim("planner", version), PlanLease):
            assert self.commit_plan(grant, "planner").ok
        assert isinstance(grant, MineLease)
        assert self.ledger.free_leases("planner") == 1

    def mine_all(self, version: str = "p1") -> list[tuple[str, int]]:
        """Plan and mine until there is nothing to do; gives log and index of what was mined."""
        mined_now: list[tuple[str, int]] = []
        while not isinstance(grant := self.claim("w1", version), NothingToDo):
            if isinstance(grant, PlanLease):
                assert self.commit_plan(grant).ok
            else:
                mined_now.append((grant.shard.log_id, grant.shard.index))
                assert self.commit_shard(grant, version=version).ok
        return mined_now

    def ids(self) -> list[str]:
        return [scene.scene_id for scene in self.ledger.current_scenes()]

    def shards(self, state: str) -> int:
        return self.ledger.status().shards_by_state.get(state, 0)


def shard_commit(
    lease: MineLease, records: dict[str, bytes], *, worker: str = "w1", sent: Sequence[bytes] = ()
) -> CommitRequest:
    return CommitRequest(
        worker_id=worker,
        lease_id=lease.lease_id,
        manifest=manifest_of(records),
        records=tuple(record.decode() for record in sent),
        stats=MiningStats(
            frames=60, points=3000, bytes_read=1100, bytes_needed=1000, range_reads=4
        ),
    )


def expected_scenes(log_ids: Sequence[str], *, shards: int = 3) -> dict[str, str]:
    """Scene id to digest of everything that these logs hold, mined undisturbed."""
    return {
        entry.scene_id: entry.sha256
        for log_id in log_ids
        for index in range(shards)
        for entry in manifest_of(mined(shard_of(log_id, index, of=shards)))
    }
