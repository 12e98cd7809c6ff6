"""Endpoints that are down or silent are named in one sentence, and soon."""

import socket
from collections.abc import Iterator
from time import monotonic

import pytest

from schemas.errors import BucketUnreachableError
from schemas.transport.bucket import open_bucket

pytestmark = pytest.mark.integration

KEY_ID, SECRET = "AKIAPUBLICID", "s3cr3t/of+the/car"


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    """A socket that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def list_s3(port: int) -> BucketUnreachableError:
    options = {
        "access_key_id": KEY_ID,
        "secret_access_key": SECRET,
        "region": "us-east-1",
        "endpoint": f"http://127.0.0.1:{port}",
    }
    begin_s = monotonic()
    with pytest.raises(BucketUnreachableError) as caught:
        list(open_bucket("s3://logs", options=options).list())
    assert monotonic() - begin_s < 25
    assert SECRET not in str(caught.value)
    return caught.value


def test_an_endpoint_that_is_down_refuses_the_connection(listening: socket.socket) -> None:
    port = listening.getsockname()[1]
    listening.close()
    assert "connection refused" in str(list_s3(port))


def test_an_endpoint_that_never_answers_is_given_up(listening: socket.socket) -> None:
    assert "no answer in time" in str(list_s3(listening.getsockname()[1]))
