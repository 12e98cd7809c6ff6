"""Benchmark of the listing: time of a page of a large ledger, by filter, order and search."""

import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.canonical import sha256
from schemas.contradiction import ContradictionKind, InstanceRecord, SceneState, TrackRecord
from schemas.score import Reason
from schemas.transport.wire import encode_scene_score
from schemas.verdict import GIVEN
from schemas.work import (
    ClaimRequest,
    CommitRequest,
    LogPlan,
    ManifestEntry,
    MineLease,
    MiningStats,
    Part,
    PlanLease,
    Recording,
    Shard,
)
from service.curation.activity import ActivityRequest
from service.curation.listing import ScenesRequest
from service.curation.verdicts import AgreementRequest, JudgeRequest
from service.store.bench_ledger import LIDAR, SCORE
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger

SCENES_PER_LOG: Final = 2000
"""Scenes of a log: a drive of 67 minutes."""

REPEATS: Final = 5
"""Times that each request is timed; the median counts."""

MOST_TRACKS: Final = 6
"""Strong tracks of a scene that has any, at most; they are of 3.4 kinds, classes and attributions
in the mean, as those of simulated logs.
"""

VERDICTS: Final = 2000
"""Verdicts in the ledger, of two reviewers."""

_VERSION: Final = "bench"
_WORKER: Final = "bench-0"
_SCENE_NS: Final = 2 * NS_PER_S
_START_NS: Final = 1_700_000_000 * NS_PER_S
_KIND: Final = ContradictionKind.ONLY_PREDICTIVE_DYNAMIC.value
_CLASSES: Final = ("car", "pedestrian", "cyclist", "truck", "bus", "")


class ListingTiming(BaseModel):
    """Time of one kind of request.

    Attributes:
        what: Filter, order or search.
        scenes: Scenes in the ledger.
        total: Scenes that pass.
        median_ms: Median time of the request, milliseconds.
        most_ms: Longest time, milliseconds.
        core_ms: Mean time of one core, milliseconds: what a machine that is shared shows as well.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str
    scenes: int = Field(ge=0)
    total: int = Field(ge=0)
    median_ms: float
    most_ms: float
    core_ms: float


def bench_listing(
    folder: Path, *, scenes: int, on_progress: Callable[[str], None] = lambda _: None
) -> list[ListingTiming]:
    """Time pages of a ledger of so many scenes; a ledger that is there already is used.

    Args:
        folder: State folder of the ledger.
        scenes: Number of scenes; missing ones are committed first.
        on_progress: Called with the name of each step.
    """
    store = open_store(folder)
    try:
        ledger = Ledger(
            store,
            now_s=lambda: time.clock_gettime(time.CLOCK_REALTIME),
            policy=LeasePolicy(lease_s=3600.0, plan_ahead=1),
        )
        on_progress(f"committing {scenes} scenes")
        _fill(ledger, scenes)
        _judge(ledger)
        stored = ledger.listing(ScenesRequest(most=1)).total
        rows = []
        for what, request in _requests(ledger).items():
            on_progress(what)
            rows.append(_timed(what, lambda r=request: ledger.listing(r).total, stored))  # type: ignore[misc]
        for what, call in _sums(ledger).items():
            on_progress(what)
            rows.append(_timed(what, call, stored))
        return rows
    finally:
        store.close()


def _requests(ledger: Ledger) -> dict[str, ScenesRequest]:
    """Return requests that let everything, little or nothing pass, in every order."""
    deep = ScenesRequest(most=200)
    after = ledger.listing(deep).next
    hour = 3600 * NS_PER_S
    return {
        "first page": ScenesRequest(),
        "second page": ScenesRequest(after=after),
        "by time": ScenesRequest(sort="latest"),
        "newest": ScenesRequest(sort="newest"),
        "most recently judged": ScenesRequest(sort="judged"),
        "one vehicle": ScenesRequest(vehicle="car-3"),
        "a vehicle without scenes": ScenesRequest(vehicle="none"),
        "a version, by time": ScenesRequest(software_version="2026.2", sort="earliest"),
        "a class": ScenesRequest(class_name="bus"),
        "a kind": ScenesRequest(kind=_KIND),
        "who errs, newest": ScenesRequest(wrong=Wrong.BOTH, sort="newest"),
        "a kind and who errs": ScenesRequest(kind=_KIND, wrong=Wrong.BOTH),
        "within 30 m": ScenesRequest(within_m=30),
        "beyond 50 m, latest": ScenesRequest(beyond_m=50, sort="latest"),
        "a kind within 30 m": ScenesRequest(kind=_KIND, within_m=30),
        "who errs beyond 50 m, newest": ScenesRequest(wrong=Wrong.BOTH, beyond_m=50, sort="newest"),
        "a class between 30 and 31 m": ScenesRequest(class_name="bus", beyond_m=30, within_m=31),
        "a range of scores": ScenesRequest(min_score=0.2, max_score=0.21),
        "the lowest scores of a class": ScenesRequest(max_score=0.051, class_name="bus"),
        "an hour of one vehicle": ScenesRequest(
            vehicle="car-3", since_ns=_START_NS + 9 * hour, until_ns=_START_NS + 10 * hour
        ),
        "a pattern of logs": ScenesRequest(log="car-1*/*7"),
        "judged": ScenesRequest(judged="yes"),
        "not judged": ScenesRequest(judged="no"),
        "not judged by the reviewer": ScenesRequest(judged="not_mine", reviewer="ann"),
        "search: a common word": ScenesRequest(text="static"),
        "search: a rare word": ScenesRequest(text="at 17.31 s"),
        "search: no match, a vehicle": ScenesRequest(text="zebra", vehicle="car-3"),
        "search: of scenes at the end": ScenesRequest(text="odometry lost", sort="score"),
        "search: a common word, by time": ScenesRequest(text="static", sort="latest"),
    }


def _sums(ledger: Ledger) -> dict[str, Callable[[], int]]:
    def count(reply: Any) -> int:
        return sum(bucket.scenes for bucket in reply.recorded)

    return {
        "activity by day": lambda: count(ledger.activity(ActivityRequest())),
        "activity by hour": lambda: count(ledger.activity(ActivityRequest(per="hour"))),
        "agreement": lambda: ledger.verdicts.agreement(AgreementRequest()).scenes,
        "choices": lambda: len(ledger.choices().vehicles),
    }


def _timed(what: str, call: Callable[[], int], scenes: int) -> ListingTiming:
    durations_s, total, begun_core_s = [], 0, time.process_time()
    for _ in range(REPEATS):
        begun_s = time.perf_counter()
        total = call()
        durations_s.append(time.perf_counter() - begun_s)
    return ListingTiming(
        what=what,
        scenes=scenes,
        total=total,
        median_ms=round(1e3 * sorted(durations_s)[REPEATS // 2], 1),
        most_ms=round(1e3 * max(durations_s), 1),
        core_ms=round(1e3 * (time.process_time() - begun_core_s) / REPEATS, 1),
    )


def _judge(ledger: Ledger) -> None:
    """Give two reviewers verdicts on the best scenes, once."""
    if ledger.verdicts.last():
        return
    dice, after = random.Random(1), ""  # noqa: S311 (no secret)
    judged = 0
    while judged < VERDICTS:
        page = ledger.listing(ScenesRequest(most=200, after=after))
        for row in page.rows:
            for reviewer in ("ann", "bob"):
                ledger.verdicts.judge(
                    JudgeRequest(
                        key=f"{reviewer} {row.seq}",
                        scene_id=row.scene_id,
                        reviewer=reviewer,
                        verdict=dice.choice(GIVEN),
                        took_s=dice.uniform(3, 15),
                    )
                )
                judged += 1
        after = page.next
        if not after:
            return


def _fill(ledger: Ledger, scenes: int) -> None:
    """Commit until the ledger has this many scenes; those it has are kept."""
    logs = -(-scenes // SCENES_PER_LOG)
    names = [
        f"car-{number % 40}/2026-{1 + number % 12:02}/drive-{number}" for number in range(logs)
    ]
    ledger.sync_recordings(
        [
            Recording(log_id=name, parts=(Part(key=f"{name}.mcap", size=1, etag=name),))
            for name in names
        ]
    )
    number_of = {name: number for number, name in enumerate(names)}
    while True:
        grant = ledger.claim(ClaimRequest(worker_id=_WORKER, pipeline_version=_VERSION)).grant
        if isinstance(grant, PlanLease):
            _commit(ledger, grant, plan=_plan(grant.recording.log_id))
        elif isinstance(grant, MineLease):
            log_id = grant.shard.log_id
            records = list(_records(log_id, number_of[log_id]))
            staged = {sha256(record): record for _, record in records}
            manifest = tuple(
                ManifestEntry(scene_id=scene_id, sha256=sha256(record))
                for scene_id, record in records
            )
            _commit(ledger, grant, staged=staged, manifest=manifest, stats=MiningStats())
        else:
            return


def _commit(
    ledger: Ledger,
    lease: PlanLease | MineLease,
    *,
    staged: dict[str, bytes] | None = None,
    **how: Any,
) -> None:
    request = CommitRequest(worker_id=_WORKER, lease_id=lease.lease_id, **how)
    answer = ledger.commit(request, staged or {})
    if not answer.ok:
        raise RuntimeError(f"the ledger refused a commit: {answer.problem or answer.missing}")


def _plan(log_id: str) -> LogPlan:
    end_ns = _START_NS + SCENES_PER_LOG * _SCENE_NS
    return LogPlan(
        log_id=log_id,
        vehicle=log_id.partition("/")[0],
        lidar_topics=(LIDAR.topic,),
        shards=(
            Shard(
                log_id=log_id,
                index=0,
                lidar=LIDAR,
                anchor_ns=_START_NS,
                warmup_start_ns=_START_NS,
                start_ns=_START_NS,
                end_ns=end_ns,
                lookahead_end_ns=end_ns,
                first_of_log=True,
                last_of_log=True,
                chunks=(),
                needed_bytes=1,
            ),
        ),
    )


def _records(log_id: str, number: int) -> Iterator[tuple[str, bytes]]:
    """Make the scenes of one log: two in five have strong tracks, one in fifty no valid score."""
    dice = random.Random(number)  # noqa: S311 (no secret)
    begin_ns = _START_NS + number * 3 * 3600 * NS_PER_S
    for cell in range(SCENES_PER_LOG):
        start_ns = begin_ns + cell * _SCENE_NS
        scene_id = f"{log_id}/lidar/{start_ns}"
        score = round(dice.random() ** 4, 6)
        state = SceneState.ODOMETRY_LOST if dice.random() < 0.02 else SceneState.SCORED
        tracks: tuple[TrackRecord, ...] = ()
        headline = "odometry lost: the poses jump"
        if state is SceneState.SCORED and score > 0.15:
            tracks = tuple(
                _track(dice, start_ns, score, number)
                for number in range(dice.randint(1, MOST_TRACKS))
            )
            name = tracks[0].class_name or "object"
            headline = (
                f"supervised labels {name} dynamic, self-supervised static, at "
                f"{dice.uniform(2, 40):.2f} s, {tracks[0].strongest.range_m:.1f} m ahead: "
                "supervised wrong"
            )
        yield (
            scene_id,
            encode_scene_score(
                SCORE.model_copy(
                    update={
                        "scene_id": scene_id,
                        "log_id": log_id,
                        "vehicle": log_id.partition("/")[0],
                        "software_version": f"2026.{number % 6}",
                        "start_ns": start_ns,
                        "end_ns": start_ns + _SCENE_NS - NS_PER_S // 10,
                        "state": state,
                        "score": score if state is SceneState.SCORED else 0.0,
                        "reasons": (Reason(headline=headline),),
                        "tracks": tracks,
                        "producers": SCORE.producers.model_copy(
                            update={"pipeline_version": _VERSION}
                        ),
                    }
                )
            ),
        )


def _track(dice: random.Random, start_ns: int, strength: float, number: int) -> TrackRecord:
    range_m = round(dice.uniform(3, 80), 2)
    wrong = dice.choice(tuple(Wrong))
    chances = {each.value: 0.1 for each in Wrong} | {wrong.value: 0.7}
    return TrackRecord(
        track_id=number,
        kind=dice.choice(tuple(ContradictionKind)).value,
        class_name=dice.choice(_CLASSES),
        strength=strength,
        first_ns=start_ns,
        last_ns=start_ns + NS_PER_S,
        frames=10,
        points=1000,
        speed_m_per_s=1.5,
        attribution=Attribution(wrong=wrong, **chances),
        strongest=InstanceRecord(
            stamp_ns=start_ns,
            points=100,
            centre_m=(range_m, 0.0, 0.0),
            size_m=(4.0, 1.8, 1.5),
            yaw_rad=0.0,
            range_m=range_m,
            semantic_confidence=0.9,
            predictive_confidence=0.8,
        ),
    )
