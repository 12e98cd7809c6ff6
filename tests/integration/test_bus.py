"""The service on a real router: questions, history for latecomers, what becomes of lost puts."""

import http.server
import json
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import structlog.testing
import zenoh
import zenoh.ext

from schemas.errors import PermanentError, TransientError
from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask, ask_until, reply_problem
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import (
    client_session,
    is_connected,
    recoverable_publisher,
    recoverable_subscriber,
    router_session,
)
from schemas.transport.wire import decode, encode
from schemas.work import Answer, CommitRequest, MineLease, PlanLease
from service.app import Service
from service.client import ControlClient
from tests.contracts.ledger_world import (
    World,
    expected_scenes,
    manifest_of,
    mined,
    shard_commit,
)
from tests.free_ports import free_endpoint
from tests.integration.running import DEADLINE_S, ROOT, Running, two_logs, until

pytestmark = pytest.mark.integration


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    with two_logs(tmp_path) as parts:
        yield parts


def test_without_a_router_a_command_fails_at_once_and_says_what_to_start() -> None:
    began_s = time.monotonic()
    with pytest.raises(TransientError, match=r"no router at .*`counterpoint run`"):
        client_session([free_endpoint()])
    assert time.monotonic() - began_s < 2


def test_a_router_links_to_one_that_starts_later() -> None:
    early, late = free_endpoint(), free_endpoint()
    began_s = time.monotonic()
    with router_session([early], connect=[late]) as first:
        assert time.monotonic() - began_s < 5, "it waits for the other in the background"
        with router_session([late]):
            until(lambda: is_connected(first), "a link to the later one")
            with (
                client_session([early]) as near,
                client_session([late]) as far,
                near.declare_queryable("asked", lambda query: query.reply("asked", b"far")),
            ):

                def is_answered() -> bool:
                    return any(reply.ok for reply in far.get("asked", timeout=2))

                until(is_answered, "an answer across both routers")


def test_a_taken_port_is_named() -> None:
    endpoint = free_endpoint()
    with router_session([endpoint]), pytest.raises(TransientError, match=endpoint):
        router_session([endpoint])


@pytest.mark.parametrize("endpoint", ["7447", "tcp/localhost", "localhost:7447", "tcp/a:b"])
def test_an_endpoint_that_is_none_is_refused_with_an_example(endpoint: str) -> None:
    with pytest.raises(PermanentError, match=r"tcp/host:port"):
        client_session([endpoint])


def test_a_daemon_waits_for_its_router() -> None:
    endpoint, opened = free_endpoint(), threading.Event()

    def wait() -> None:
        with client_session([endpoint], stop=threading.Event()):
            opened.set()

    waiting = threading.Thread(target=wait)
    waiting.start()
    assert not opened.wait(0.3)
    with router_session([endpoint]):
        assert opened.wait(DEADLINE_S)
        waiting.join()


def test_a_daemon_that_waits_for_its_router_can_be_stopped() -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(StoppedError):
        client_session([free_endpoint()], stop=stop)


def test_a_session_outlives_its_router() -> None:
    endpoint = free_endpoint()
    with ExitStack() as first:
        first.enter_context(router_session([endpoint]))
        with client_session([endpoint]) as asker, client_session([endpoint]) as answerer:

            def answer(query: zenoh.Query) -> None:
                with query:
                    query.reply("here", b"yes")

            with answerer.declare_queryable("here", answer):
                until(lambda: _answered(asker, "here"), "an answer")
                first.close()
                until(lambda: not is_connected(asker), "the loss of the router to be seen")
                with pytest.raises(UnansweredError):
                    ask(asker, "here")
                with router_session([endpoint]):
                    until(lambda: _answered(asker, "here"), "an answer through the new router")


def test_silence_refusal_and_time_up_are_told_apart() -> None:
    endpoint = free_endpoint()
    kept: queue.SimpleQueue[zenoh.Query] = queue.SimpleQueue()

    def refuse(query: zenoh.Query) -> None:
        with query:
            reply_problem(query, PermanentError("no such scene"))

    with (
        router_session([endpoint]),
        client_session([endpoint]) as asker,
        client_session([endpoint]) as answerer,
        answerer.declare_queryable("refused", refuse),
        answerer.declare_queryable("kept", kept.put),
    ):
        with pytest.raises(UnansweredError, match="no service answers"):
            ask(asker, "nobody")
        until(lambda: not _unanswered(asker, "refused"), "the queryable to be known")
        with pytest.raises(PermanentError, match=r"^no such scene$"):
            ask(asker, "refused")
        with pytest.raises(UnansweredError, match="within"):
            ask(asker, "kept", timeout_s=0.3)
        with kept.get(timeout=DEADLINE_S):
            pass


def test_a_worker_that_nobody_answers_says_so_once_and_when_it_is_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("schemas.transport.ask.SILENT_S", 0.5)
    endpoint, key = free_endpoint(), f"{ROOT}/v1/control/claim"
    with (
        router_session([endpoint]) as router,
        client_session([endpoint]) as client,
        structlog.testing.capture_logs() as events,
    ):
        with pytest.raises(UnansweredError):
            ask_until(client, key, stop=threading.Event(), patience_s=1.5)
        said = [each for each in events if each["event"] == "no service answers"]
        assert len(said) == 1
        assert "do the rules of the routers name this certificate" in said[0]["problem"]
        waiting = threading.Timer(
            1.5, lambda: router.declare_queryable(key, lambda query: query.reply(key, b"here"))
        )
        waiting.start()
        assert ask_until(client, key, stop=threading.Event(), patience_s=DEADLINE_S) == b"here"
        waiting.join()
    assert [each["event"] for each in events].count("the service answers again") == 1


def test_whoever_comes_late_gets_every_scene_and_then_what_is_new(running: Running) -> None:
    world = running.world
    world.mine_all()
    expected = expected_scenes(["a", "b"])
    with running.watching() as watching:
        until(lambda: watching.digests() == expected, "the history")
        running.add_log("c")
        until(lambda: "c" in _log_ids(world), "the new log to be listed")
        world.mine_all()
        until(lambda: watching.digests() == expected_scenes(["a", "b", "c"]), "the new scenes")
    seqs = [event.seq for event in watching.events]
    assert seqs == sorted(set(seqs)) == list(range(1, len(seqs) + 1))


def test_a_watcher_may_ask_for_the_newest_few_only(running: Running) -> None:
    running.world.mine_all()
    stored = running.world.ledger.current_scenes()
    with running.watching(history=2) as watching:
        until(lambda: len(watching.events) >= 2, "two scenes")
        running.add_log("c")
        until(lambda: "c" in _log_ids(running.world), "the new log to be listed")
        running.world.mine_all()
        until(lambda: len(watching.events) >= 2 + 9, "the new scenes")
    old = [event.scene_id for event in watching.events if not event.scene_id.startswith("c/")]
    assert old == [scene.scene_id for scene in stored[-2:]]


def test_a_stock_subscriber_gets_the_history_and_then_what_is_new(running: Running) -> None:
    running.world.mine_all()
    records: dict[str, bytes] = {}
    seqs: list[int] = []

    def take(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        records[str(sample.key_expr)] = sample.payload.to_bytes()
        seqs.append(json.loads(sample.attachment.to_bytes())["seq"])

    with client_session([running.endpoint]) as session:
        subscriber = zenoh.ext.declare_advanced_subscriber(
            session, f"{ROOT}/v1/scene/**", take, history=zenoh.ext.HistoryConfig()
        )
        with subscriber:
            until(lambda: len(records) == 18, "the history")
            assert seqs == list(range(1, 19))
            running.add_log("c")
            until(lambda: "c" in _log_ids(running.world), "the new log to be listed")
            running.world.mine_all()
            until(lambda: len(records) == 27, "the new scenes")
    stored = running.world.ledger.current_scenes()
    assert set(records.values()) == {scene.record for scene in stored}


def test_a_scene_lost_on_its_way_is_fetched(running: Running) -> None:
    with running.watching() as watching:
        running.world.mine_all()
        until(lambda: len(watching.events) == 18, "the scenes of both logs")
        running.stop_router()
        until(lambda: not _service_reachable(running), "the router to be gone")
        running.add_log("c")
        until(lambda: "c" in _log_ids(running.world), "the new log to be listed")
        running.world.mine_all()
        # As if they had been put into the void by a service that did not notice the loss in time.
        running.world.ledger.mark_published(running.world.ledger.last_seq())
        running.start_router()
        until(lambda: len(watching.events) == 27, "the scenes that nobody published")
    assert watching.digests() == expected_scenes(["a", "b", "c"])


def test_what_was_committed_while_no_router_was_there_is_published_later(running: Running) -> None:
    world = running.world
    running.stop_router()
    world.mine_all()
    assert world.ledger.status().published_seq == 0
    running.start_router()
    until(lambda: world.ledger.status().published_seq == world.ledger.last_seq(), "publication")


def test_a_restarted_service_publishes_what_its_predecessor_had_not(running: Running) -> None:
    world = running.world
    with running.watching() as watching:
        running.stop_service()
        world.mine_all()
        running.start_service()
        until(lambda: len(watching.events) == 18, "every scene")


def test_a_scene_of_a_deleted_log_is_withdrawn(running: Running) -> None:
    running.world.mine_all()
    with running.watching() as watching:
        until(lambda: len(watching.events) == 18, "the history")
        (running.logs / "a.mcap").unlink()
        until(lambda: len(watching.events) == 27, "the withdrawals")
    gone = {event.scene_id for event in watching.events if event.withdrawn}
    assert gone == set(expected_scenes(["a"]))
    with running.watching() as late:
        until(lambda: len(late.events) == 9, "what is left")
    assert late.digests() == expected_scenes(["b"])


def test_a_selection_is_stored_and_published_scene_by_scene(running: Running) -> None:
    running.world.mine_all()
    published: dict[str, bytes] = {}
    with (
        client_session([running.endpoint]) as session,
        session.declare_subscriber(
            f"{ROOT}/v1/selected/**",
            lambda sample: published.__setitem__(str(sample.key_expr), sample.payload.to_bytes()),
        ),
    ):
        client = ControlClient([running.endpoint], root=ROOT)
        selection = client.select(budget=3, name="week 47")
        until(lambda: len(published) == 3, "the selected scenes")
    assert all(key.startswith(f"{ROOT}/v1/selected/week%2047/") for key in published)
    chosen = {scene.scene_id for scene in selection.scenes}
    assert {json.loads(payload)["scene_id"] for payload in published.values()} == chosen
    with client_session([running.endpoint]) as late:
        replies = [reply.ok for reply in late.get(f"{ROOT}/v1/selected/**")]
    asked = {str(ok.key_expr): ok.payload.to_bytes() for ok in replies if ok is not None}
    assert asked == published
    with pytest.raises(PermanentError, match="week 47"):
        client.select(budget=1, name="week 47")
    assert client.selection("week 47") == selection
    assert [(row.name, row.scenes) for row in client.selections()] == [("week 47", 3)]
    with pytest.raises(PermanentError, match="no selection 'week 48'"):
        client.selection("week 48")


def test_the_verbs_answer_what_the_ledger_knows(running: Running) -> None:
    running.world.mine_all()
    client = ControlClient([running.endpoint], root=ROOT)
    top = client.top()
    assert len(top) == 18
    assert client.scene(top[0].scene_id).score == top[0].score
    assert client.status().scenes == 18
    with pytest.raises(PermanentError, match=r"no current scene 'x/y/0'"):
        client.scene("x/y/0")
    with pytest.raises(PermanentError, match="overlay"):
        client.overlay(top[0].scene_id)


def test_a_question_that_is_no_question_is_refused_and_the_service_lives(running: Running) -> None:
    with client_session([running.endpoint]) as session:
        with pytest.raises(PermanentError, match="not a request"):
            ask(session, keys.control(root=ROOT, verb="commit"), b"{}")
        with pytest.raises(PermanentError, match="not a request"):
            ask(session, keys.control(root=ROOT, verb="claim"), b"\xff")
        assert ask(session, keys.control(root=ROOT, verb="hello")) == encode(
            running.settings.mining()
        )


def test_without_a_service_a_verb_says_so_and_to_try_again() -> None:
    endpoint = free_endpoint()
    with (
        router_session([endpoint]),
        pytest.raises(TransientError, match="`counterpoint run`"),
    ):
        ControlClient([endpoint], root=ROOT).top()


def test_a_bucket_that_is_gone_withdraws_nothing_and_is_waited_for(running: Running) -> None:
    world = running.world
    world.mine_all()
    away = running.logs.with_name("unmounted")
    with structlog.testing.capture_logs() as said:
        running.logs.rename(away)
        until(lambda: any(entry["event"] == "trying again" for entry in said), "the loss seen")
        (away / "c.mcap").write_bytes(b"c")
        away.rename(running.logs)
        until(lambda: "c" in _log_ids(world), "the listing of the bucket that is back")
    assert len(world.ledger.current_scenes()) == 18
    assert [e["event"] for e in said if e["event"].startswith(("trying", "works"))] == [
        "trying again",
        "works again",
    ]
    running.service.check()


def test_a_bucket_that_refuses_for_a_while_is_waited_out(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "id")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "withdrawn while it was in use")
    running.stop_service()
    running.world.ledger.sync_recordings([])  # a state of no logs may serve any bucket
    with (
        http.server.HTTPServer(("127.0.0.1", 0), Revoked) as server,
        client_session([running.endpoint]) as session,
    ):
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        options = {"endpoint": f"http://127.0.0.1:{server.server_port}", "region": "nowhere"}
        bucket = open_bucket("s3://fleet", options=options)
        try:
            with Service(
                running.settings,
                session,
                running.world.ledger,
                bucket=bucket,
            ) as service:
                until(lambda: Revoked.listings > LAST_REFUSED, "a listing after the refused ones")
                service.check()
        finally:
            server.shutdown()
            serving.join()


LAST_REFUSED = 3


class Revoked(http.server.BaseHTTPRequestHandler):
    """An S3 server that lists an empty bucket once, refuses twice, and then lists again."""

    listings = 0

    def do_GET(self) -> None:
        Revoked.listings += 1
        empty = b"<ListBucketResult><Name>fleet</Name></ListBucketResult>"
        refuses = 1 < Revoked.listings <= LAST_REFUSED
        body = b"<Error><Code>AccessDenied</Code></Error>" if refuses else empty
        self.send_response(403 if refuses else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def test_a_second_service_under_the_same_root_is_refused(running: Running) -> None:
    with client_session([running.endpoint]) as session:
        second = Service(
            running.settings,
            session,
            running.world.ledger,
            bucket=open_bucket(str(running.logs)),
        )
        with pytest.raises(TransientError, match="another service"):
            second.__enter__()


def test_a_commit_names_what_never_arrived_and_takes_it_from_the_next_one(
    running: Running,
) -> None:
    world = running.world
    while isinstance(grant := world.claim(), PlanLease):
        world.commit_plan(grant)
    assert isinstance(grant, MineLease)
    lease = grant
    records = mined(lease.shard)
    first, *rest = records.values()
    key = keys.control(root=ROOT, verb="commit")
    with client_session([running.endpoint]) as session:
        score_key = keys.score(root=ROOT, worker_id="w1")
        with recoverable_publisher(session, score_key) as publisher:
            publisher.put(first)
            request = shard_commit(lease, records)
            answer = _commit(session, key, request)
            assert not answer.ok
            assert set(answer.missing) == {entry.scene_id for entry in manifest_of(records)[1:]}
            answer = _commit(session, key, shard_commit(lease, records, sent=rest))
    assert answer.ok
    assert {scene.record for scene in world.ledger.current_scenes()} == set(records.values())


def test_a_service_that_joins_late_still_hears_what_a_living_worker_published(
    running: Running,
) -> None:
    world = running.world
    while isinstance(grant := world.claim(), PlanLease):
        world.commit_plan(grant)
    assert isinstance(grant, MineLease)
    lease = grant
    records = mined(lease.shard)
    with client_session([running.endpoint]) as session:
        score_key = keys.score(root=ROOT, worker_id="w1")
        with recoverable_publisher(session, score_key) as publisher:
            running.stop_service()
            for record in records.values():
                publisher.put(record)
            running.start_service()
            request = shard_commit(lease, records)
            assert _commit(session, keys.control(root=ROOT, verb="commit"), request).ok


def test_what_the_bus_lost_for_good_is_counted() -> None:
    endpoint = free_endpoint()
    got: list[bytes] = []
    misses: list[int] = []
    with ExitStack() as opened, ExitStack() as router:
        router.enter_context(router_session([endpoint]))
        opened.callback(router.close)
        hearing = opened.enter_context(client_session([endpoint]))
        opened.enter_context(
            recoverable_subscriber(
                hearing,
                "records/**",
                lambda sample: got.append(sample.payload.to_bytes()),
                on_miss=misses.append,
            )
        )
        putting = opened.enter_context(client_session([endpoint]))
        publisher = opened.enter_context(
            zenoh.ext.declare_advanced_publisher(  # without a cache, to fetch what was missed from
                putting,
                "records/1",
                congestion_control=zenoh.CongestionControl.DROP,
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=0.1
                ),
            )
        )

        def put_until(condition: Callable[[], bool], what: str) -> None:
            def put() -> bool:
                publisher.put(b"arrives, or is counted")
                return condition()

            until(put, what)

        put_until(lambda: bool(got), "a first record")
        router.close()
        until(lambda: not is_connected(putting), "the loss of the router to be seen")
        publisher.put(b"lost")
        publisher.put(b"lost")
        router.enter_context(router_session([endpoint]))
        put_until(lambda: bool(misses), "the miss to be noticed")
    assert sum(misses) >= 2
    assert b"lost" not in got


def _commit(session: zenoh.Session, key: str, request: CommitRequest) -> Answer:
    stop = threading.Event()
    return decode(
        Answer, ask_until(session, key, encode(request), stop=stop, patience_s=DEADLINE_S)
    )


def _answered(session: zenoh.Session, key: str) -> bool:
    return not _unanswered(session, key)


def _unanswered(session: zenoh.Session, key: str) -> bool:
    try:
        ask(session, key)
    except UnansweredError:
        return True
    except PermanentError:
        return False
    return False


def _log_ids(world: World) -> set[str]:
    return {log.log_id for log in world.ledger.status().logs}


def _service_reachable(running: Running) -> bool:
    try:
        ControlClient([running.endpoint], root=ROOT).status()
    except TransientError:
        return False
    return True
