"""Requests under a held lease wait in a lane of their own; invented leases are never written."""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from threading import Event, Thread
from typing import Any
from uuid import uuid4

import pytest
import zenoh

from schemas.mining import MiningSettings
from schemas.transport.wire import encode
from schemas.work import (
    ClaimRequest,
    CommitRequest,
    FailRequest,
    MineLease,
    PlanLease,
    RenewRequest,
)
from service.api.control import Control
from service.api.held_leases import HEAD_BYTES, MOST_KNOWN, HeldLeases
from service.api.request_queue import RequestQueue
from service.api.staging import Staging
from service.store.engine import Store, open_store
from tests.contracts.ledger_world import World

LEASE = uuid4().hex


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    with closing(open_store(tmp_path)) as store:
        yield World.on(store)


def renewal(lease_id: str) -> bytes:
    return encode(RenewRequest(worker_id="w", lease_id=lease_id))


def test_a_lease_is_found_in_a_message_of_each_verb_and_only_while_it_is_held() -> None:
    leases = HeldLeases()
    commit = CommitRequest(worker_id="w" * 100, lease_id=LEASE, records=("x" * 10_000,))
    fail = FailRequest(worker_id="w", lease_id=LEASE, error="e", permanent=False)
    messages = [renewal(LEASE), encode(commit), encode(fail)]
    assert [leases.held_in(each) for each in messages] == [None] * 3
    leases.add(LEASE)
    assert [leases.held_in(each) for each in messages] == [LEASE] * 3
    assert leases.held_in(renewal(uuid4().hex)) is None
    assert leases.held_in(b" " * HEAD_BYTES + renewal(LEASE)) is None
    leases.discard(LEASE)
    assert leases.held_in(messages[0]) is None


def test_the_least_recently_used_lease_is_forgotten() -> None:
    leases = HeldLeases()
    leases.add("first")
    leases.add("second")
    leases.add("first")
    for number in range(MOST_KNOWN - 1):
        leases.add(str(number))
    assert "first" in leases
    assert "second" not in leases


def test_a_worker_passes_a_flood_of_invented_leases() -> None:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    leases, answered, go = HeldLeases(), [], Event()
    leases.add(LEASE)
    done, left = Event(), 40

    def answer(payload: bytes) -> bytes:
        go.wait(10)
        answered.append(leases.held_in(payload))
        if len(answered) == left + 2:
            done.set()
        return b"{}"

    with zenoh.open(config) as session:
        requests = RequestQueue(session, leases=leases)
        requests.declare("ctl/renew", answer, asked="renew")
        stop = Event()
        thread = Thread(target=requests.serve, args=(stop,), kwargs={"writes": True})
        thread.start()
        try:
            waiting: list[Any] = [
                session.get("ctl/renew", payload=renewal(uuid4().hex)) for _ in range(left)
            ]
            waiting += [session.get("ctl/renew", payload=renewal(LEASE)) for _ in range(2)]
            began_s = time.monotonic()
            while requests.waiting < left + 1 and time.monotonic() - began_s < 10:
                time.sleep(0.01)  # the thread has the first of the flood
            go.set()
            assert done.wait(10)
        finally:
            stop.set()
            thread.join()
            requests.close()
        del waiting
    assert answered.count(LEASE) == 2
    assert answered.index(LEASE) <= 2, "one of the flood was begun, and one more had its turn"
    assert answered[: answered.index(LEASE) + 3].count(LEASE) == 2


def control(world: World) -> Control:
    return Control(
        settings=MiningSettings(bucket="memory://", artifacts="memory://"),
        ledger=world.ledger,
        staging=Staging(),
        on_scenes=lambda: None,
        on_selection=lambda _: None,
    )


def test_leases_are_known_from_their_claim_until_their_end(world: World) -> None:
    asked = control(world)
    leases = asked.leases
    world.listed("a")
    grant = asked.answer_claim(ClaimRequest(worker_id="w", pipeline_version="p1")).grant
    assert isinstance(grant, PlanLease | MineLease)
    assert grant.lease_id in leases
    leases.discard(grant.lease_id)  # as after a restart
    renew = RenewRequest(worker_id="w", lease_id=grant.lease_id)
    assert asked.answer_renew(renew).ok
    assert grant.lease_id in leases
    theirs = FailRequest(worker_id="other", lease_id=LEASE, error="e", permanent=True)
    assert "no such lease" in asked.answer_fail(theirs).problem
    fail = FailRequest(worker_id="w", lease_id=grant.lease_id, error="e", permanent=False)
    assert asked.answer_fail(fail).ok
    assert grant.lease_id not in leases


def test_an_invented_lease_is_refused_without_a_writing_transaction(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*_: object) -> None:
        raise AssertionError("nothing is written for an invented lease")

    monkeypatch.setattr(Store, "write", write)
    asked = control(world)
    request = {"worker_id": "w", "lease_id": LEASE}
    answers = [
        asked.answer_renew(RenewRequest.model_validate(request)),
        asked.answer_fail(FailRequest(worker_id="w", lease_id=LEASE, error="e", permanent=True)),
        asked.answer_commit(CommitRequest.model_validate(request)),
    ]
    assert [answer.ok for answer in answers] == [False] * 3
    assert {answer.problem for answer in answers} == {f"no such lease: {LEASE}; claim again"}
