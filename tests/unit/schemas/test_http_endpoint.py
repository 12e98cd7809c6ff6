import http.client
import json
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import pytest
from prometheus_client import CollectorRegistry, Counter
from structlog.testing import capture_logs

from schemas.errors import PermanentError, TransientError
from schemas.runtime import http_endpoint
from schemas.runtime.http_clients import MOST_OF_AN_ADDRESS
from schemas.runtime.http_endpoint import (
    Handler,
    HttpEndpoint,
    HttpRequest,
    HttpResponse,
    json_response,
    metrics_route,
    text_response,
)

ANYWHERE = "127.0.0.1:0"


def asked(
    endpoint: HttpEndpoint, path: str, *, method: str = "GET", accept: str = ""
) -> tuple[int, str, str]:
    """Status, content type and body."""
    connection = http.client.HTTPConnection("127.0.0.1", endpoint.port, timeout=10)
    try:
        connection.request(method, path, headers={"Accept": accept} if accept else {})
        response = connection.getresponse()
        return response.status, response.headers["Content-Type"], response.read().decode()
    finally:
        connection.close()


@contextmanager
def serving(**routes: Handler) -> Iterator[HttpEndpoint]:
    by_path: Mapping[str, Handler] = {f"/{name}": handler for name, handler in routes.items()}
    with HttpEndpoint(ANYWHERE, by_path) as endpoint:
        yield endpoint


def test_a_handler_gets_the_parameters_decoded_and_its_answer_arrives_whole() -> None:
    def echo(request: HttpRequest) -> HttpResponse:
        return json_response(dict(request.query))

    with serving(echo=echo) as endpoint:
        status, kind, body = asked(endpoint, "/echo?by=hour&since=a%20b%2Bc&until=")
    assert (status, kind) == (200, "application/json")
    assert json.loads(body) == {"by": "hour", "since": "a b+c", "until": ""}


def test_head_answers_without_a_body_and_nothing_else_is_taken() -> None:
    with serving(healthz=lambda _: text_response("alive")) as endpoint:
        assert asked(endpoint, "/healthz", method="HEAD")[::2] == (200, "")
        assert asked(endpoint, "/healthz", method="POST")[0] == 405


def test_an_unknown_path_is_told_which_there_are() -> None:
    with serving(b=lambda _: text_response("b"), a=lambda _: text_response("a")) as endpoint:
        status, _, body = asked(endpoint, "/c")
    assert status == 404
    assert "/a, /b" in body


@pytest.mark.parametrize(
    ("error", "status"),
    [(PermanentError("no such group"), 400), (TransientError("database is locked"), 503)],
)
def test_an_error_on_purpose_is_its_sentence(error: Exception, status: int) -> None:
    def refuse(_: HttpRequest) -> HttpResponse:
        raise error

    with serving(rates=refuse) as endpoint:
        assert asked(endpoint, "/rates")[::2] == (status, f"{error}\n")


def test_a_broken_handler_is_logged_and_the_next_request_is_answered() -> None:
    def broken(_: HttpRequest) -> HttpResponse:
        raise ZeroDivisionError

    with capture_logs() as events, serving(a=broken, b=lambda _: text_response("b")) as endpoint:
        assert asked(endpoint, "/a")[0] == 500
        assert asked(endpoint, "/b")[0] == 200
    (failed,) = [event for event in events if event["log_level"] == "error"]
    assert failed["path"] == "/a"
    assert failed["exc_info"]


def test_metrics_of_several_registries_are_one_page_in_either_format() -> None:
    registries = [CollectorRegistry(), CollectorRegistry()]
    for name, registry in zip("ab", registries, strict=True):
        Counter(f"counterpoint_{name}", "Counts.", registry=registry).inc()
    with serving(metrics=metrics_route(*registries)) as endpoint:
        _, plain, text = asked(endpoint, "/metrics")
        _, openmetrics, marked = asked(
            endpoint, "/metrics", accept="application/openmetrics-text;version=1.0.0,*/*;q=0.1"
        )
    assert plain.startswith("text/plain; version=0.0.4")
    assert openmetrics.startswith("application/openmetrics-text; version=1.0.0")
    for page in (text, marked):
        assert "counterpoint_a_total 1.0\n" in page
        assert "counterpoint_b_total 1.0\n" in page
    assert "# EOF" not in text
    assert marked.count("# EOF") == 1
    assert marked.endswith("# EOF\n")


def test_an_address_in_use_is_a_sentence_that_names_address_and_setting() -> None:
    with serving() as endpoint:
        taken = f"127.0.0.1:{endpoint.port}"
        with pytest.raises(TransientError, match=f"{taken}.*in use.*worker_http_listen"):
            HttpEndpoint(taken, {}, setting="worker_http_listen")


def test_an_address_is_free_again_as_soon_as_the_endpoint_is_closed() -> None:
    """A daemon started again must not wait a minute for the connections of its last life."""
    with serving(healthz=lambda _: text_response("alive")) as endpoint:
        assert asked(endpoint, "/healthz")[0] == 200
    with HttpEndpoint(f"127.0.0.1:{endpoint.port}", {}) as again:
        assert again.port == endpoint.port


@pytest.mark.parametrize("listen", ["9464", "localhost", "host:port", "127.0.0.1:65536"])
def test_what_is_no_address_is_refused(listen: str) -> None:
    with pytest.raises(PermanentError, match="host:port"):
        HttpEndpoint(listen, {})


def test_ipv6_is_listened_on_where_the_machine_has_it() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with HttpEndpoint("[::1]:0", {"/healthz": lambda _: text_response("alive")}) as endpoint:
        assert endpoint.url == f"http://[::1]:{endpoint.port}"
        connection = http.client.HTTPConnection("::1", endpoint.port, timeout=10)
        connection.request("GET", "/healthz")
        assert connection.getresponse().read() == b"alive\n"
        connection.close()


def test_clients_that_say_nothing_are_left_and_hold_up_neither_the_others_nor_the_end() -> None:
    before = threading.active_count()
    with serving(healthz=lambda _: text_response("alive")) as endpoint:
        stuck = [
            socket.create_connection(("127.0.0.1", endpoint.port), timeout=10)
            for _ in range(MOST_OF_AN_ADDRESS - 1)
        ]
        assert asked(endpoint, "/healthz")[0] == 200
        assert threading.active_count() <= before + 1 + MOST_OF_AN_ADDRESS
    assert threading.active_count() == before
    for client in stuck:
        assert client.recv(1) == b""
        client.close()


def test_a_silent_client_makes_room_when_its_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_endpoint, "HEAD_DEADLINE_S", 0.05)
    with serving(healthz=lambda _: text_response("alive")) as endpoint:
        with socket.create_connection(("127.0.0.1", endpoint.port), timeout=10) as silent:
            assert silent.recv(1) == b""
        assert asked(endpoint, "/healthz")[0] == 200


def test_an_endpoint_may_be_closed_before_its_block_ends() -> None:
    with HttpEndpoint(ANYWHERE, {}) as endpoint:
        endpoint.close()
        with pytest.raises(ConnectionRefusedError):
            asked(endpoint, "/healthz")
        endpoint.close()
