"""Large payloads are refused by what they would cost to decode; honest ones are not."""

import json

import pytest

from schemas.bounds import MAX_DENSE_BYTES
from schemas.errors import PermanentError
from schemas.transport.wire import decode, encode
from schemas.work import ChunkRef, CommitRequest, FailRequest, LogPlan, ManifestEntry
from service.api.payload_check import require_affordable

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
    with pytest.raises(PermanentError, match="a message of "):
        require_affordable(CommitRequest, payload)


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
        require_affordable(CommitRequest, payload.encode())


def test_a_list_of_wrong_entries_costs_one_error() -> None:
    payload = HEAD + b'"manifest":[' + b'"twelve bytes",' * 15_000 + b'""]}'
    with pytest.raises(ValueError, match="1 validation error"):
        CommitRequest.model_validate_json(payload)


def test_an_error_that_quotes_half_a_surrogate_pair_can_be_sent() -> None:
    fail = FailRequest(worker_id="w", lease_id="l", error="field \ud800 is odd", permanent=True)
    assert decode(FailRequest, encode(fail)).error == "field ? is odd"
