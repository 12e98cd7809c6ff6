"""Clients that are slow, many or malformed neither keep a probe out nor see a traceback."""

import http.client
import itertools
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Final

import pytest
from structlog.testing import capture_logs

from schemas.runtime import http_endpoint
from schemas.runtime.http_endpoint import (
    Handler,
    HttpEndpoint,
    HttpRequest,
    HttpResponse,
    text_response,
)

LORISES: Final = 200


@contextmanager
def serving(**pages: Handler) -> Iterator[HttpEndpoint]:
    routes = {f"/{name}": page for name, page in pages.items()}
    routes.setdefault("/healthz", lambda _: text_response("alive"))
    with HttpEndpoint("127.0.0.1:0", routes) as endpoint:
        yield endpoint


def probed(endpoint: HttpEndpoint) -> float:
    """Ask once as a probe does; return how long it took in seconds, infinite if it failed."""
    begin = time.monotonic()
    try:
        with closing(http.client.HTTPConnection("127.0.0.1", endpoint.port, timeout=5)) as probe:
            probe.request("GET", "/healthz")
            assert probe.getresponse().read() == b"alive\n"
    except OSError:
        return float("inf")
    return time.monotonic() - begin


def said(endpoint: HttpEndpoint, *packets: bytes) -> bytes:
    """All that is answered to these bytes."""
    with socket.create_connection(("127.0.0.1", endpoint.port), timeout=10) as client:
        for packet in packets:
            try:
                client.sendall(packet)
            except OSError:
                break
        answer = b""
        while more := client.recv(1 << 16):
            answer += more
        return answer


@contextmanager
def lorises(endpoint: HttpEndpoint, addresses: list[str]) -> Iterator[None]:
    """Hold connections that send a byte of a request now and then, and come back if dropped."""
    over = threading.Event()
    sources = itertools.cycle(addresses)

    def connected() -> socket.socket:
        address = ("127.0.0.1", endpoint.port)
        return socket.create_connection(address, timeout=10, source_address=(next(sources), 0))

    def trickle() -> None:
        while not over.wait(0.3):
            for index, client in enumerate(clients):
                try:
                    client.sendall(b"a")
                except OSError:
                    client.close()
                    clients[index] = connected()

    clients = [connected() for _ in range(LORISES)]
    for client in clients:
        try:
            client.sendall(b"GET /healthz HTTP/1.1\r\nX: ")
        except OSError:
            continue
    thread = threading.Thread(target=trickle)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        for client in clients:
            client.close()


@pytest.mark.parametrize(
    "addresses", [["127.0.0.1"], [f"127.0.0.{last}" for last in range(2, 22)]], ids=["one", "many"]
)
def test_a_probe_is_answered_within_a_second_beside_two_hundred_slow_clients(
    addresses: list[str],
) -> None:
    before = threading.active_count()
    with serving() as endpoint:
        with lorises(endpoint, addresses):
            took_s = []
            for _ in range(8):
                took_s.append(probed(endpoint))
                time.sleep(0.2)
            assert max(took_s) < 1
        begin = time.monotonic()
    assert time.monotonic() - begin < 2
    assert threading.active_count() == before


def test_the_whole_head_has_one_deadline_however_it_is_cut(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(http_endpoint, "HEAD_DEADLINE_S", 0.5, raising=False)
    with serving() as endpoint, ExitStack() as opened:
        client = opened.enter_context(
            socket.create_connection(("127.0.0.1", endpoint.port), timeout=10)
        )
        begin = time.monotonic()
        client.sendall(b"GET /healthz HTTP/1.1\r\n")
        client.settimeout(0.1)
        answer = b""
        while not answer and time.monotonic() - begin < 3:
            client.sendall(b"X")
            try:
                answer = client.recv(1000)
            except TimeoutError:
                continue
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert 0.4 < time.monotonic() - begin < 2


def test_a_client_that_takes_its_answer_slowly_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_endpoint, "SEND_DEADLINE_S", 0.5, raising=False)
    before = threading.active_count()
    large = text_response("a" * 50_000_000)
    with (
        serving(large=lambda _: large) as endpoint,
        socket.create_connection(("127.0.0.1", endpoint.port), timeout=10) as client,
    ):
        client.sendall(b"GET /large HTTP/1.1\r\n\r\n")
        assert client.recv(10_000)
        begin = time.monotonic()
        while threading.active_count() > before + 1 and time.monotonic() - begin < 4:
            client.recv(10_000)
            time.sleep(0.05)
        assert time.monotonic() - begin < 2


def test_a_page_that_hangs_keeps_no_probe_out() -> None:
    over, entered = threading.Event(), threading.Semaphore(0)

    def hang(_: HttpRequest) -> HttpResponse:
        entered.release()
        over.wait(20)
        return text_response("late")

    with serving(rates=hang) as endpoint, ExitStack() as opened:
        opened.callback(over.set)
        clients = [
            opened.enter_context(socket.create_connection(("127.0.0.1", endpoint.port), timeout=10))
            for _ in range(100)
        ]
        for client in clients:
            try:
                client.sendall(b"GET /rates HTTP/1.1\r\n\r\n")
            except OSError:
                continue
        assert entered.acquire(timeout=5)
        assert probed(endpoint) < 1


GOOD: Final = b"GET /healthz HTTP/1.1\r\n"


@pytest.mark.parametrize(
    ("packets", "status", "words"),
    [
        pytest.param([b"\r\n\r\n"], 400, b"no request", id="nothing"),
        pytest.param([b"GET /healthz\r\n"], 400, b"no request", id="HTTP/0.9"),
        pytest.param([b"GET  /healthz HTTP/1.1\r\n\r\n"], 400, b"no request", id="two spaces"),
        pytest.param([b"GET /a b HTTP/1.1\r\n\r\n"], 400, b"no request", id="a space"),
        pytest.param([b"GET /healthz HTTP/2.0\r\n\r\n"], 400, b"no request", id="HTTP/2"),
        pytest.param([b"GET /healthz HTTP/9\r\n\r\n"], 400, b"no request", id="bad version"),
        pytest.param([b"\x16\x03\x01\x02\x00\x01\x00\n\n"], 400, b"no request", id="TLS"),
        pytest.param([b"GET /heal\0thz HTTP/1.1\r\n\r\n"], 400, b"no request", id="NUL"),
        pytest.param([b"GET /heal%00thz HTTP/1.1\r\n\r\n"], 400, b"NUL", id="encoded NUL"),
        pytest.param([b"GET /healthz%zz HTTP/1.1\r\n\r\n"], 400, b"hexadecimal", id="broken %"),
        pytest.param([b"GET /healthz% HTTP/1.1\r\n\r\n"], 400, b"hexadecimal", id="open %"),
        pytest.param([b"GET /%ff HTTP/1.1\r\n\r\n"], 400, b"UTF-8", id="no UTF-8"),
        pytest.param([b"GET /healthz?a=%f HTTP/1.1\r\n\r\n"], 400, b"hexadecimal", id="query %"),
        pytest.param([b"GET /healthz?a=%00 HTTP/1.1\r\n\r\n"], 400, b"NUL", id="query NUL"),
        pytest.param([b"GET http://a/healthz HTTP/1.1\r\n\r\n"], 400, b"proxy", id="absolute"),
        pytest.param([b"GET * HTTP/1.1\r\n\r\n"], 400, b"proxy", id="star"),
        pytest.param([b"GET /healthz#a HTTP/1.1\r\n\r\n"], 400, b"proxy", id="fragment"),
        pytest.param([b"GET /healthz?a=1&a=2 HTTP/1.1\r\n\r\n"], 400, b"given twice", id="twice"),
        pytest.param(
            [b"GET /healthz?" + b"&".join(b"p%d=" % n for n in range(20)) + b" HTTP/1.1\r\n\r\n"],
            400,
            b"at most 16 parameters",
            id="parameters",
        ),
        pytest.param(
            [b"GET /healthz?a=" + b"a" * 3000 + b" HTTP/1.1\r\n\r\n"],
            400,
            b"at most 2048 bytes",
            id="query",
        ),
        pytest.param(
            [b"GET /healthz?a=", *[b"a" * 10_000] * 100, b" HTTP/1.1\r\n\r\n"],
            400,
            b"at most 8192 bytes",
            id="query of 1 MB",
        ),
        pytest.param([GOOD, b"X: " + b"a" * 9000, b"\r\n\r\n"], 400, b"8192", id="header"),
        pytest.param([GOOD, b"X: a\r\n" * 101, b"\r\n"], 400, b"64 headers", id="headers"),
        pytest.param([GOOD, b"X a\r\n\r\n"], 400, b"NAME: VALUE", id="no colon"),
        pytest.param([GOOD, b"X: a\r\n b\r\n\r\n"], 400, b"NAME: VALUE", id="folded"),
        pytest.param([GOOD, b"X: a\0\r\n\r\n"], 400, b"NAME: VALUE", id="NUL in a header"),
        pytest.param([GOOD, b"Content-Length: 2\r\n\r\nab"], 400, b"no body", id="body"),
        pytest.param([GOOD, b"Content-Length: x\r\n\r\n"], 400, b"no body", id="length"),
        pytest.param(
            [GOOD, b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n"], 400, b"no body", id="chunked"
        ),
        pytest.param([b"POST /healthz HTTP/1.1\r\n\r\n"], 405, b"GET or HEAD", id="POST"),
        pytest.param([b"BREW /healthz HTTP/1.1\r\n\r\n"], 405, b"GET or HEAD", id="BREW"),
        pytest.param([GOOD, b"Content-Length: 0\r\n\r\n"], 200, b"alive", id="empty body"),
        pytest.param([b"GET /healthz HTTP/1.0\n\n"], 200, b"alive", id="HTTP/1.0"),
        pytest.param([b"GET /%68ealthz HTTP/1.1\r\n\r\n"], 200, b"alive", id="encoded"),
        pytest.param([*(bytes([b]) for b in GOOD), b"\r", b"\n"], 200, b"alive", id="bytewise"),
    ],
)
def test_a_malformed_request_is_answered_with_a_sentence(
    packets: list[bytes], status: int, words: bytes
) -> None:
    with capture_logs() as events, serving() as endpoint:
        head, _, body = said(endpoint, *packets).partition(b"\r\n\r\n")
        assert probed(endpoint) < 5
    assert head.startswith(b"HTTP/1.1 %d " % status)
    assert (b"\r\nAllow: GET, HEAD" in head) == (status == 405)
    assert words in body
    assert body.count(b"\n") == 1
    assert b"Traceback" not in body
    assert f"Content-Length: {len(body)}".encode() in head
    assert not [event for event in events if event["log_level"] == "error"]


@pytest.mark.parametrize(
    ("target", "status"), [(b"/healthz", 200), (b"/none", 404), (b"/healthz?a=%", 400)]
)
def test_head_says_what_get_would_and_sends_no_body(target: bytes, status: int) -> None:
    with serving() as endpoint:
        got = said(endpoint, b"GET " + target + b" HTTP/1.1\r\n\r\n").partition(b"\r\n\r\n")
        head = said(endpoint, b"HEAD " + target + b" HTTP/1.1\r\n\r\n").partition(b"\r\n\r\n")
    assert head[0].startswith(b"HTTP/1.1 %d " % status)
    assert head[2] == b""
    assert got[2]
    assert f"Content-Length: {len(got[2])}".encode() in head[0]


def test_random_bytes_never_end_in_an_error_of_the_endpoint() -> None:
    rng = random.Random(1)  # noqa: S311
    edits: list[Callable[[bytearray], None]] = [
        lambda data: data.insert(rng.randrange(len(data)), rng.randrange(256)),
        lambda data: data.__setitem__(rng.randrange(len(data)), rng.randrange(256)),
        lambda data: data.__delitem__(rng.randrange(len(data))),
    ]
    whole = GOOD + b"Accept: */*\r\nHost: a\r\n"
    with capture_logs() as events, serving() as endpoint:
        for _ in range(300):
            data = bytearray(whole)
            for _ in range(rng.randrange(1, 6)):
                rng.choice(edits)(data)
            answer = said(endpoint, bytes(data) + b"\r\n\r\n")
            assert answer[9:12] in {b"200", b"400", b"404", b"405"}, bytes(data)
    assert not [event for event in events if event["log_level"] == "error"]
