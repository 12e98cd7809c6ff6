"""Large payloads are refused by what they would cost to decode; honest ones are not."""

import json

import pytest
from pydantic import ValidationError

from schemas.bounds import MAX_DENSE_BYTES
from schemas.errors import PermanentError
from schemas.transport.affordable import too_costly
from schemas.transport.wire import decode, decode_reply, encode
from schemas.work import ChunkRef, CommitRequest, FailRequest, LogPlan, ManifestEntry
from service.curation.status import LogStatus, Status

HEAD = b'{"worker_id":"w","lease_id":"l",'


@pytest.mark.parametrize(
    "payload",
    [
        pytest.param(HEAD + b'"manifest":[' + b"0," * 2_000_000 + b"0]}", id="numbers as entries"),
        pytest.param(b"[" + b"0," * 2_000_000 + b"0]", id="a list in place of a message"),
        pytest.param(
            HEAD + b",".join(b'"name-%07d":0' % number for number in range(100_000)) + b"}",
            id="unknown fields",
        ),
        pytest.param(HEAD + b'"\\u0061",' + b'"x":1,' * 100_000 + b"}", id="one field many times"),
    ],
)
def test_what_would_grow_when_it_is_decoded_is_refused(payload: bytes) -> None:
    with pytest.raises(ValidationError, match="a message of ") as refused:
        decode(CommitRequest, payload)
    assert refused.value.error_count() == 1


def test_a_large_plan_and_a_large_manifest_are_decoded() -> None:
    chunk = ChunkRef(part=0, offset=10**6, length=10**6, start_ns=10**18, end_ns=10**18 + 10**8)
    plan = {
        "log_id": "a",
        "shards": [{"chunks": [chunk.model_dump(mode="json")] * 50_000}],
        "lidar_topics": ["/lidar"],
    }
    assert LogPlan.model_fields.keys() >= plan.keys()
    entry = ManifestEntry(scene_id="a/lidar/1557540000000000000", sha256="0" * 64)
    for body in (
        {"plan": plan},
        {
            "manifest": [entry.model_dump()] * 10_000,
            "records": [json.dumps({"deep": [0] * 1000})] * 1000,
        },
    ):
        payload = json.dumps({"worker_id": "w", "lease_id": "l"} | body, separators=(",", ":"))
        assert len(payload) > MAX_DENSE_BYTES
        assert too_costly(CommitRequest, payload.encode()) == ""


def test_a_list_of_wrong_entries_costs_one_error() -> None:
    payload = HEAD + b'"manifest":[' + b'"twelve bytes",' * 15_000 + b'""]}'
    with pytest.raises(ValueError, match="1 validation error"):
        CommitRequest.model_validate_json(payload)


def test_an_error_that_quotes_half_a_surrogate_pair_can_be_sent() -> None:
    fail = FailRequest(worker_id="w", lease_id="l", error="field \ud800 is odd", permanent=True)
    assert decode(FailRequest, encode(fail)).error == "field ? is odd"


def test_a_reply_that_nobody_can_afford_or_read_is_refused_in_one_sentence() -> None:
    for payload in (b'{"logs":[' + b"0," * 500_000 + b"0]}", b'{"logs":0}'):
        with pytest.raises(PermanentError, match="answer to status cannot be read") as refused:
            decode_reply(Status, payload, to="status")
        assert "\n" not in str(refused.value)


def test_the_status_of_many_logs_is_read() -> None:
    states = ("pending", "leased", "done", "parked")
    logs = tuple(
        LogStatus(log_id=f"car/{n}", state="done", shards=dict.fromkeys(states, n))
        for n in range(5000)
    )
    payload = encode(Status(pipeline_version="1", logs=logs))
    assert len(payload) > MAX_DENSE_BYTES
    assert decode(Status, payload).logs == logs
