"""Check of a manifest's records, before any transaction."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import ValidationError

from schemas.canonical import sha256
from schemas.score import SCHEMA_VERSION, SceneScore
from schemas.task import MOTION
from schemas.transport.wire import decode
from schemas.work import CommitRequest


@dataclass(frozen=True, slots=True)
class Verified:
    """Result of checking a shard's manifest before the transaction.

    Attributes:
        scenes: Id to score, record and digest, of the entries whose bytes are present and right.
        problem: Error for which the commit can never be accepted; empty if it can.
    """

    scenes: Mapping[str, tuple[SceneScore, bytes, str]]
    problem: str = ""


def verify(request: CommitRequest, staged: Mapping[str, bytes]) -> Verified:
    """Find and check the records of a manifest. Pure, so that the transaction is short.

    Bytes that do not match their digest count as missing: they were damaged on the way.
    """
    sent = {sha256(text.encode()): text.encode() for text in request.records}
    scenes: dict[str, tuple[SceneScore, bytes, str]] = {}
    seen: set[str] = set()
    for entry in request.manifest:
        if entry.scene_id in seen:
            return Verified({}, f"manifest names a scene twice: {entry.scene_id}")
        seen.add(entry.scene_id)
        record = sent.get(entry.sha256)
        if record is None:
            record = staged.get(entry.sha256)
            if record is None or sha256(record) != entry.sha256:
                continue
        try:
            score = decode(SceneScore, record)
        except ValidationError as error:
            cause = error.errors()[0]
            where = ".".join(map(str, cause["loc"])) or "the record"
            return Verified({}, f"not a scene score: {where}: {cause['msg']} ({entry.scene_id})")
        if score.sentences_version != SCHEMA_VERSION:
            return Verified(
                {}, f"a record of an earlier version; update the worker ({entry.scene_id})"
            )
        if score.task != MOTION.name:
            return Verified({}, f"a scene of the task {score.task}: motion alone is ranked here")
        if score.scene_id != entry.scene_id:
            return Verified({}, f"record is of another scene: {score.scene_id} ({entry.scene_id})")
        scenes[entry.scene_id] = (score, record, entry.sha256)
    return Verified(scenes)
