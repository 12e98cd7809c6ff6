"""Guests on the bus of a day, who ask and send what no part of the system would."""

import random
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import zenoh
from sqlalchemy import select

from schemas.canonical import sha256
from schemas.problem import Problem
from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys
from schemas.transport.ask import PROBLEM
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.wire import decode, encode
from schemas.work import Answer, ClaimReply, ClaimRequest, MineLease, NothingToDo, PlanLease
from service.api.verbs import VERBS
from service.curation.status import Status
from service.store.engine import open_store_to_read
from service.store.tables import LEASES
from tests.contracts.ledger_world import plan_of, score_of
from tests.fuzz.questions import DAMAGES, WILD, payload_of

PATIENCE_S: Final = 20.0
"""For an answer, while the machine mines."""

FLOOD: Final = 4000
"""Requests that are sent without waiting for an answer: as many as a queue takes."""

ABSURD_PER_VERB: Final = 12

GUEST: Final = "guest"

OTHER_LOG: Final = "car-99/am/forged"

_SAMPLES: Final[dict[str, dict[str, Any]]] = {
    "renew": {"worker_id": GUEST, "lease_id": "none"},
    "commit": {
        "worker_id": GUEST,
        "lease_id": "none",
        "manifest": [{"scene_id": "a/b/1", "sha256": "0"}],
        "records": ["{}"],
        "damage": [{"key": "a", "offset": 0, "bytes": 1, "what": "x"}],
        "stats": {"frames": 1, "points": 1, "stage_s": {"ingest": 1.0}},
    },
    "fail": {"worker_id": GUEST, "lease_id": "none", "error": "x", "permanent": True},
    "top": {"most": 1},
    "rates": {"by": "hour", "since_ns": 0, "until_ns": 1},
    "scene": {"scene_id": "car-0/am/whole/lidar/1"},
    "overlay": {"scene_id": "car-0/am/whole/lidar/1"},
}
"""Messages that are right and change nothing; to other verbs only what is no message is sent."""


class Guest:
    """A client with a session of its own, which means no good."""

    def __init__(self, endpoint: str, state: Path, rng: random.Random) -> None:
        """Take the router's endpoint, the state that it may read, and its chance."""
        self._endpoint, self._state, self._rng = endpoint, state, rng

    def ask_absurdly(self) -> int:
        """Ask every verb for what cannot be; return how many questions were refused.

        Raises:
            AssertionError: If one gets neither an answer nor a sentence.
        """
        refused = 0
        with closing(client_session([self._endpoint])) as session:
            for verb in VERBS:
                for payload in self._absurd(verb):
                    refused += not isinstance(_ask(session, verb, payload), bytes)
        return refused

    def forge_commits(self) -> int:
        """Commit under leases of others, under none, and under its own what is not of its work.

        Raises:
            AssertionError: If a forged commit is taken, or gets no answer.
        """
        with closing(client_session([self._endpoint])) as session:
            forged = [
                commit
                for lease_id in ("none", "", "\ud800", "x" * 70_000, *self._held_leases())
                for commit in (_empty(lease_id), *self._absurd_commits(lease_id))
            ]
            own = self._own_lease(session)
            if own is not None:
                forged += self._absurd_commits(own.lease_id)
                forged += _of_other_work(own)
            for commit in forged:
                _must_be_refused(session, commit)
            return len(forged)

    def forge_samples(self) -> int:
        """Put to the keys of scores and scenes what no worker and no service puts there."""
        record = encode(score_of("car-0/am/whole", 1))
        junk = (b"", b"\0", b"{}", b"[" * 10_000, record[:-1], record * 20, b"x" * 5_000_000)
        numbers = (b"", b"{}", b"x", b'{"seq":-1}', b'{"seq":9223372036854775808}', b'{"seq":NaN}')
        sent = 0
        with closing(client_session([self._endpoint])) as session:
            for name in (GUEST, "a/b", "%FF", "x" * 5_000):
                for payload in (*junk, record):
                    session.put(f"{ROOT}/v1/score/{name}", payload)
                    sent += 1
            for name in ("x", "a/b", "a/b/c", "%FF/%00", "car-0%2Fam%2Fwhole/lidar%2F1"):
                for payload in junk:
                    session.put(f"{ROOT}/v1/scene/{name}", payload)
                for number in numbers:
                    session.put(f"{ROOT}/v1/scene/{name}", record, attachment=number)
                    session.delete(f"{ROOT}/v1/scene/{name}", attachment=number)
                sent += len(junk) + 2 * len(numbers)
        return sent

    def flood(self) -> int:
        """Ask for the status again and again without waiting; return how many were answered.

        Raises:
            AssertionError: If a question does not end, or nothing is answered.
        """
        lock, all_over = threading.Lock(), threading.Event()
        answered, over = 0, 0

        def take(reply: zenoh.Reply) -> None:
            nonlocal answered
            with lock:
                answered += reply.ok is not None

        def end() -> None:
            nonlocal over
            with lock:
                over += 1
                if over == FLOOD:
                    all_over.set()

        key = keys.control(root=ROOT, verb="status")
        with closing(client_session([self._endpoint])) as session:
            for _ in range(FLOOD):
                session.get(key, zenoh.handlers.Callback(take, end), timeout=PATIENCE_S)
            assert all_over.wait(2 * PATIENCE_S), f"of {FLOOD} questions only {over} ended"
        assert answered, "no question of a flood was answered"
        return answered

    def _absurd(self, verb: str) -> Iterator[bytes]:
        sample = _SAMPLES.get(verb)
        for _ in range(ABSURD_PER_VERB):
            wild, damage = self._rng.choice(WILD), self._rng.choice(sorted(DAMAGES))
            if sample is None or self._rng.random() < 0.3:
                yield payload_of(wild, (), damage)
            else:
                yield payload_of(sample, ((self._rng.randrange(400), wild),), "none")
        yield DAMAGES["large"](b"")

    def _absurd_commits(self, lease_id: str) -> list[bytes]:
        commit = _SAMPLES["commit"] | {"lease_id": lease_id}
        score = score_of(OTHER_LOG, 1)
        large = encode(score)[:-1] + b',"reasons":"' + b"x" * MAX_RECORD_BYTES + b'"}'
        changes: tuple[dict[str, Any], ...] = (
            {},
            {"damage": [{"key": "a", "offset": 2**63, "bytes": 2**64, "what": "x"}]},
            {"stats": {"frames": 10**400, "points": self._rng.choice((-1, 2**63))}},
            {"manifest": [{"scene_id": "x" * 70_000, "sha256": "x" * 70_000}]},
            {"manifest": [{"scene_id": "\ud800", "sha256": "\0"}]},
            {"manifest": [{"scene_id": score.scene_id, "sha256": sha256(encode(score))}]},
            {
                "manifest": [{"scene_id": score.scene_id, "sha256": sha256(large)}],
                "records": [large.decode()],
            },
            {"manifest": [{"scene_id": "a/b/1", "sha256": "0"}] * 20_000},
            {"plan": {"log_id": OTHER_LOG}},
        )
        return [payload_of(commit | change, (), "none") for change in changes]

    def _held_leases(self) -> list[str]:
        """Name a lease that a worker holds now, if there is one."""
        held = select(LEASES.c.lease_id).where(LEASES.c.is_held).limit(1)
        with closing(open_store_to_read(self._state)) as store, store.reading() as connection:
            return [row.lease_id for row in connection.execute(held)]

    def _own_lease(self, session: zenoh.Session) -> PlanLease | MineLease | None:
        """Claim something under the version of the workers; None if there is nothing to do."""
        status = _ask(session, "status", b"")
        assert isinstance(status, bytes), status
        version = decode(Status, status).pipeline_version
        if not version:
            return None
        request = ClaimRequest(worker_id=GUEST, pipeline_version=version)
        answer = _ask(session, "claim", encode(request))
        assert isinstance(answer, bytes), answer
        grant = decode(ClaimReply, answer).grant
        return None if isinstance(grant, NothingToDo) else grant


def _of_other_work(lease: PlanLease | MineLease) -> list[bytes]:
    """Commits in good form, under a lease that is held, of work that is not the lease's."""
    other, own = plan_of(OTHER_LOG), plan_of(lease.recording.log_id)
    foreign = own.model_copy(update={"shards": other.shards})
    twice = own.model_copy(update={"shards": (*own.shards, own.shards[0])})
    record = encode(score_of(OTHER_LOG, 1))
    scene = {"scene_id": score_of(OTHER_LOG, 1).scene_id, "sha256": sha256(record)}
    base = {"worker_id": GUEST, "lease_id": lease.lease_id}
    forged: list[dict[str, Any]] = [
        *({"plan": plan.model_dump(mode="json")} for plan in (other, foreign, twice)),
        {"manifest": [scene], "records": [record.decode()]},
        {"manifest": [scene, scene], "records": [record.decode()]},
    ]
    return [payload_of(base | each, (), "none") for each in forged]


def _empty(lease_id: str) -> bytes:
    return payload_of({"worker_id": GUEST, "lease_id": lease_id}, (), "none")


def _must_be_refused(session: zenoh.Session, commit: bytes) -> None:
    answer = _ask(session, "commit", commit)
    taken = isinstance(answer, bytes) and decode(Answer, answer).ok
    assert not taken, f"a forged commit is taken: {commit[:500]!r}"


def _ask(session: zenoh.Session, verb: str, payload: bytes) -> bytes | Problem:
    """Ask once.

    Raises:
        AssertionError: If there is neither an answer nor a problem in time.
    """
    replies = list(
        session.get(keys.control(root=ROOT, verb=verb), payload=payload, timeout=PATIENCE_S)
    )
    asked = f"{verb} {payload[:300]!r}"
    assert replies, f"no reply at all to {asked}"
    (reply,) = replies
    if reply.ok is not None:
        return reply.ok.payload.to_bytes()
    assert reply.err is not None
    assert reply.err.encoding == PROBLEM, f"no answer within {PATIENCE_S:g} s to {asked}"
    return decode(Problem, reply.err.payload.to_bytes())
