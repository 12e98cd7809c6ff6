"""Decodes odd messages of the bus as receivers do: `python -m tests.fuzz.messages --examples N`.

Records, requests, leases and announcements are made by hypothesis from seeds: right ones, and ones
of the fields' types, then spoilt and damaged. Each is decoded, or refused in one sentence; what was
decoded encodes to bytes that decode to the same.
"""

import argparse
import resource
import sys
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from schemas.canonical import sha256
from schemas.events import RankedScene, SceneNumber
from schemas.problem import Problem
from schemas.score import SceneScore
from schemas.transport import keys
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.wire import decode, encode, first_problem
from schemas.verdict import VerdictRow
from schemas.work import ClaimReply, CommitRequest, ManifestEntry, MineLease, PlanLease
from service.api.staging import MOST_BYTES, Staging
from service.api.verbs import VERBS
from service.store.manifest import verify
from tests.contracts.ledger_world import plan_of, score_of
from tests.fuzz.parts import run_parts
from tests.fuzz.questions import WILD, damages, messages_of, payload_of, spoilings

SLOW_S: Final = 10.0
"""Processor time after which decoding counts as a hang, seconds."""

MOST_MB: Final = 1500
MOST_SENTENCE: Final = 600
"""Characters of a refusal."""

Made = tuple[str, type[BaseModel], bytes]
"""Form of a message, its kind, and its bytes."""


@dataclass(slots=True)
class Decoded:
    """Outcomes of messages.

    Attributes:
        ends: Form of a message, to how often it was decoded or refused.
        failures: What went wrong, with the first message that it went wrong with.
        slowest_s: Longest processor time of one message, seconds.
    """

    ends: dict[str, Counter[str]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    slowest_s: float = 0.0

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(map(Counter.total, self.ends.values()))


def main() -> int:
    """Decode, and say how it went; 1 if a message was neither decoded nor refused."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.messages")
    asked.add_argument("--examples", type=int, default=20_000, help="how many messages")
    asked.add_argument("--seed", type=int, default=0, help="of the first part")
    how = asked.parse_args()
    found = decode_many(how.examples, first_seed=how.seed)
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    for sent_as, ends in sorted(found.ends.items()):
        counts = ", ".join(f"{count} {end}" for end, count in sorted(ends.items()))
        sys.stdout.write(f"{sent_as:12s} {counts}\n")
    sys.stdout.write(f"{found.count} messages, peak memory {megabytes} MB, ")
    sys.stdout.write(f"slowest {found.slowest_s:.2f} s, failures {len(found.failures)}\n")
    for what, first in found.failures.items():
        sys.stdout.write(f"{what}\n    first: {first}\n")
    return int(bool(found.failures) or megabytes > MOST_MB)


def decode_many(examples: int, *, first_seed: int = 0) -> Decoded:
    """Decode so many messages.

    Args:
        examples: How many.
        first_seed: Seed of the first part.
    """
    found, staging = Decoded(), Staging()
    run_parts(
        messages(),
        lambda made: _receive(made, staging, found),
        examples=examples,
        first_seed=first_seed,
    )
    return found


def messages() -> st.SearchStrategy[Made]:
    """Make messages of every kind that a process of the system decodes."""
    sent: dict[str, tuple[type[BaseModel], ...]] = {
        "request": tuple(verb.request for verb in VERBS.values() if verb.request is not None),
        "reply": tuple(verb.reply for verb in VERBS.values() if verb.reply is not None),
        "announcement": (SceneNumber, RankedScene, VerdictRow, Problem),
        "record": (SceneScore,),
        "lease": (ClaimReply,),
    }
    made = [
        _damaged(sent_as, kind, messages_of(kind)) for sent_as in sent for kind in sent[sent_as]
    ]
    right = [_damaged(*each, st.just(base)) for each, base in _right()]
    return st.one_of(st.one_of(*made), st.one_of(*right))


def _right() -> list[tuple[tuple[str, type[BaseModel]], Any]]:
    """Messages that are right in all their depth, laid out for JSON."""
    score, plan = score_of("car-7", 1), plan_of("car-7")
    recording = {"log_id": "car-7", "parts": [{"key": "car-7.mcap", "size": 9, "etag": "e"}]}
    held = {"lease_id": "l", "expires_s": 60.0, "recording": recording}
    mine = MineLease.model_validate(held | {"shard": plan.shards[0].model_dump(mode="json")})
    entry = ManifestEntry(scene_id=score.scene_id, sha256=sha256(encode(score)))
    by = {"worker_id": "w", "lease_id": "l"}
    commit = CommitRequest(**by, manifest=(entry,), records=(encode(score).decode(),))
    right = (
        ("record", score),
        ("lease", ClaimReply(grant=mine)),
        ("lease", ClaimReply(grant=PlanLease.model_validate(held))),
        ("request", commit),
        ("request", CommitRequest(**by, plan=plan)),
        ("announcement", SceneNumber(seq=7)),
    )
    return [((name, type(each)), each.model_dump(mode="json")) for name, each in right]


def _damaged(
    sent_as: str, kind: type[BaseModel], bases: st.SearchStrategy[Any]
) -> st.SearchStrategy[Made]:
    odd = st.one_of(bases, bases, bases, bases, st.sampled_from(WILD))
    payloads = st.builds(payload_of, odd, spoilings(), damages())
    return payloads.map(lambda payload: (sent_as, kind, payload))


def _receive(made: Made, staging: Staging, found: Decoded) -> None:
    sent_as, kind, payload = made
    began_s = time.process_time()
    try:
        problem = _problem_of(sent_as, kind, payload, staging)
    except Exception as error:  # noqa: BLE001
        _fail(found, f"{sent_as} {kind.__name__}: {type(error).__name__}: {error}"[:300], payload)
        problem = "failed"
    seconds = time.process_time() - began_s
    found.slowest_s = max(found.slowest_s, seconds)
    end = "refused" if problem else "decoded"
    found.ends.setdefault(sent_as, Counter())["failed" if problem == "failed" else end] += 1
    if seconds > SLOW_S:
        _fail(found, f"{kind.__name__} took {seconds:.1f} s", payload)
    if "\n" in problem or len(problem) > MOST_SENTENCE:
        _fail(found, f"{kind.__name__}: no sentence: {problem[:200]!r}", payload)


def _problem_of(sent_as: str, kind: type[BaseModel], payload: bytes, staging: Staging) -> str:
    """Do with a message what its receiver does; return why it is refused, or nothing.

    Raises:
        AssertionError: If a message is not the same after a round trip, or the memory of waiting
            records has no bound.
    """
    if sent_as == "record":
        staging.add(payload)
        assert staging.waiting_bytes <= MOST_BYTES, staging.waiting_bytes
        _check_commit_of(payload)
    try:
        message = decode(kind, payload)
    except ValidationError as error:
        return first_problem(error)
    assert decode(kind, encode(message)) == message, "not the same after a round trip"
    if isinstance(message, SceneScore):
        _check_key_of(message)
    return ""


def _check_commit_of(record: bytes) -> None:
    """Let the check of manifests see a record; any refusal is a sentence."""
    digest = sha256(record)
    entries = (ManifestEntry(scene_id="car-7/lidar/1", sha256=digest),)
    commit = CommitRequest(worker_id="w", lease_id="l", manifest=entries)
    staged: Mapping[str, bytes] = {digest: record}
    checked = verify(commit, staged)
    assert bool(checked.problem) != bool(checked.scenes), checked


def _check_key_of(score: SceneScore) -> None:
    """The key of a scene that was taken names it, or is refused as too long."""
    try:
        key = keys.scene(root=ROOT, log_id=score.log_id, scene_id=score.scene_id)
    except keys.KeyTooLongError:
        return
    if score.scene_id.startswith(f"{score.log_id}/"):
        assert keys.scene_id_of(key, root=ROOT) == score.scene_id, key


def _fail(found: Decoded, what: str, payload: bytes) -> None:
    found.failures.setdefault(what, repr(payload[:300]))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
