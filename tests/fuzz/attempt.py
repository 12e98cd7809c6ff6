"""Takes one log the whole way that service and workers take it, and says how that ended.

Listed, inspected, planned, mined, committed to a real ledger, ranked; what travels over the bus is
encoded and decoded on the way. Only the bus itself is left out.
"""

import re
import traceback
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zenoh

from schemas.errors import CounterpointError, PermanentError
from schemas.events import SceneNumber
from schemas.mining import Grid, MiningSettings
from schemas.transport import keys
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import group_recordings
from schemas.transport.wire import decode, encode
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    FailRequest,
    ManifestEntry,
    MineLease,
    PlanLease,
    Recording,
)
from service.curation.rates import RatesRequest, rates
from service.store.engine import open_store
from service.store.ledger import LeasePolicy, Ledger
from workers.ingest.inspect import inspect_recording
from workers.ingest.plan import plan_recording
from workers.mine import MiningReport, mine_records
from workers.parts.protocols import Parts
from workers.version import parts_of, pipeline_version

MOST_SHARDS: Final = 8
"""Mined of one log; the rest of them would take time and show nothing else."""

MOST_KEY_BYTES: Final = 65_535
"""Of a key of the bus; a longer one panics."""


@dataclass(slots=True)
class Outcome:
    """How one log went.

    Attributes:
        end: `mined`, `no scenes`, `refused`, or `failed` where a part of the program failed.
        scenes: Committed.
        shards: Planned.
        damage: Stretches that were said to be damaged.
        problem: Why it was refused; of a failure its type and place.
        trace: Of a failure.
    """

    end: str = "no scenes"
    scenes: int = 0
    shards: int = 0
    damage: int = 0
    problem: str = ""
    trace: str = ""


class WrongError(Exception):
    """The log went on, but not as it must."""


class Trial:
    """A ledger and the parts of a worker, which take one log after the other."""

    def __init__(self, folder: Path) -> None:
        """Open the ledger of a folder, and build parts that need no network."""
        self._bucket = open_bucket("memory://")
        self._artifacts = open_bucket(str(folder / "artifacts"), create=True)
        self._store = open_store(folder)
        self._now_s = 1_000_000.0
        policy = LeasePolicy(settle_s=0.0, max_attempts=2)
        self._ledger = Ledger(self._store, now_s=lambda: self._now_s, policy=policy)
        self._settings = MiningSettings(
            bucket="memory://",
            artifacts=str(folder / "artifacts"),
            grid=Grid(scene_s=0.5, shard_s=0.5, warmup_s=0.2),
            supervised="recorded",
        )
        self._parts: Parts = parts_of(self._settings)
        self._version = pipeline_version(self._settings, self._parts)

    def close(self) -> None:
        """Close the ledger."""
        self._store.close()

    def take(self, name: str, data: bytes) -> Outcome:
        """Take a log the whole way.

        Args:
            name: Of the log.
            data: The file.
        """
        outcome = Outcome()
        key = f"{name}.mcap"
        self._bucket.put(key, data)
        try:
            (recording,) = group_recordings(self._bucket.list())
            self._ledger.sync_recordings([recording])
            self._inspect(recording)
            self._mine(outcome)
            self._look()
        except Exception as error:  # noqa: BLE001  # any of them is what this program looks for
            outcome.end = "failed"
            outcome.problem = f"{_said(error)} at {_place(error.__cause__ or error)}"
            outcome.trace = "".join(traceback.format_exception(error))
        finally:
            self._bucket.delete(key)
            self._now_s += 3600.0
            self._ledger.expire()
        return outcome

    def _inspect(self, recording: Recording) -> None:
        for verify in (False, True):
            try:
                report = inspect_recording(self._bucket, recording, self._settings, verify=verify)
            except CounterpointError as error:
                str(error).encode()
            else:
                encode(report)

    def _mine(self, outcome: Outcome) -> None:
        request = ClaimRequest(worker_id="w1", pipeline_version=self._version)
        for _ in range(MOST_SHARDS + 4):
            reply = self._ledger.claim(decode(ClaimRequest, encode(request)))
            grant = decode(ClaimReply, encode(reply)).grant
            if isinstance(grant, PlanLease):
                self._plan(grant, outcome)
            elif isinstance(grant, MineLease):
                self._mine_shard(grant, outcome)
            else:
                break
        if outcome.scenes:
            outcome.end = "mined"

    def _plan(self, lease: PlanLease, outcome: Outcome) -> None:
        try:
            plan = plan_recording(self._bucket, lease.recording, self._settings)
        except CounterpointError as error:
            self._fail(lease, error, outcome)
            return
        outcome.shards, outcome.damage = len(plan.shards), len(plan.damage)
        request = CommitRequest(worker_id="w1", lease_id=lease.lease_id, plan=plan)
        self._commit(request, {})
        if plan.refused:
            outcome.end, outcome.problem = "refused", plan.refused

    def _mine_shard(self, lease: MineLease, outcome: Outcome) -> None:
        account, records = MiningReport(), {}
        manifest = []
        mining = mine_records(
            self._bucket,
            lease.recording,
            lease.shard,
            settings=self._settings,
            parts=self._parts,
            pipeline_version=self._version,
            report=account,
        )
        try:
            with closing(mining):
                for mined in mining:
                    _store_overlay(self._artifacts, mined.overlay_key, mined.overlay)
                    records[mined.sha256] = mined.record
                    entry = ManifestEntry(scene_id=mined.score.scene_id, sha256=mined.sha256)
                    manifest.append(entry)
        except CounterpointError as error:
            self._fail(lease, error, outcome)
            return
        outcome.damage += len(account.damage)
        request = CommitRequest(
            worker_id="w1",
            lease_id=lease.lease_id,
            manifest=tuple(manifest),
            damage=tuple(account.damage),
            stats=account.stats(),
        )
        self._commit(request, records)
        outcome.scenes += len(manifest)

    def _commit(self, request: CommitRequest, records: dict[str, bytes]) -> None:
        answer = decode(
            Answer, encode(self._ledger.commit(decode(CommitRequest, encode(request)), records))
        )
        if not answer.ok:
            raise WrongError(f"a commit of good work is refused: {answer.problem} {answer.missing}")

    def _fail(
        self, lease: PlanLease | MineLease, error: CounterpointError, outcome: Outcome
    ) -> None:
        request = FailRequest(
            worker_id="w1",
            lease_id=lease.lease_id,
            error=str(error),
            permanent=isinstance(error, PermanentError),
        )
        self._ledger.fail(decode(FailRequest, encode(request)))
        outcome.end, outcome.problem = "refused", str(error)

    def _look(self) -> None:
        """Read everything that is shown or published."""
        encode(self._ledger.status())
        for scene in self._ledger.current_scenes():
            key = keys.scene(root=keys.DEFAULT_ROOT, log_id=scene.log_id, scene_id=scene.scene_id)
            if len(key.encode()) >= MOST_KEY_BYTES:
                raise WrongError(f"a scene whose key is too long for the bus: {len(key)} bytes")
            zenoh.KeyExpr(key)
            encode(SceneNumber(seq=scene.seq))
            scene.decoded()
        self._ledger.ranking()
        for by in ("vehicle", "version", "kind", "hour", "log"):
            for row in rates(self._ledger.rate_sums(RatesRequest(by=by)), by):
                encode(row)


def _store_overlay(artifacts: Bucket, key: str, overlay: bytes) -> None:
    try:
        artifacts.put(key, overlay)
    except CounterpointError as error:  # a worker would wait for ever for the store to be mended
        raise WrongError(f"an overlay cannot be stored: {error}") from error


def _said(error: BaseException) -> str:
    """Its type and the first words, numbers left out, so that like failures read alike."""
    return re.sub(r"\d+", "N", f"{type(error).__name__}: {error}".splitlines()[0])[:120]


def _place(error: BaseException) -> str:
    """The last line of ours that an error went through, then where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [each for each in frames if "site-packages" not in each.filename]
    shown = [ours[-1]] if ours else []
    shown += frames[-1:] if frames and frames[-1] not in shown else []
    return ", in ".join(
        f"{'/'.join(Path(each.filename).parts[-2:])}:{each.lineno} {each.name}" for each in shown
    )
