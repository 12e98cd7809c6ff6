"""One worker in this process, on a real router and service: its leases, its errors, its end."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from structlog.testing import capture_logs

from schemas.mining import Grid
from schemas.runtime.retry import StoppedError
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT
from schemas.transport.router_watch import RouterWatch
from schemas.work import PlanLease
from service.app import Service
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from tests.integration.small_s3 import SmallS3
from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.lab.simulation.world.street_builder import build_street
from workers.worker.config import WorkerConfig, WorkerObserver
from workers.worker.lease import LeaseKeeper, LeaseLostError, Leases
from workers.worker.loop import Worker
from workers.worker.metrics import WorkerMetrics

pytestmark = pytest.mark.integration

DEADLINE_S = 240.0
SMALL = Lidar(elevation_deg=UNEVEN_64[::4], columns=120)


class Place:
    """A bucket of small logs, its service, and a session for a worker."""

    def __init__(
        self,
        folder: Path,
        opened: ExitStack,
        *,
        bucket: str = "",
        artifacts: str = "",
        seconds: float = 4,
        settle_s: float = 0.0,
        drain_s: float = 30.0,
    ) -> None:
        self.logs = folder / "logs"
        self.logs.mkdir()
        (folder / "state").mkdir()
        self.write_log("a", seconds=seconds)
        self.world = World.on(open_store(folder / "state"), settle_s=settle_s)
        opened.callback(self.world.store.close)
        endpoint = free_endpoint()
        self.router = opened.enter_context(router_session([endpoint]))
        settings = Settings(
            bucket=bucket or str(self.logs),
            artifacts=artifacts or str(folder / "overlays"),
            grid=Grid(shard_s=2.0),
            supervised="recorded",
            list_interval_s=0.1,
            settle_s=0.0,
        )
        service = Service(
            settings,
            opened.enter_context(client_session([endpoint])),
            self.world.ledger,
            bucket=open_bucket(str(self.logs)),
        )
        opened.enter_context(service)
        self.session: zenoh.Session = opened.enter_context(client_session([endpoint]))
        self.config = WorkerConfig("w1", (endpoint,), drain_s=drain_s)

    def write_log(self, name: str, *, seconds: float) -> None:
        street = build_street(0, seconds=seconds, style="stands")
        write_log(self.logs / f"{name}.mcap", street, lidar=SMALL, chunk_bytes=1 << 16)

    def cut_off(self) -> None:
        """Take the router away."""
        self.router.close()  # type: ignore[no-untyped-call]

    def leases(self) -> Leases:
        return Leases(self.session, root=DEFAULT_ROOT, worker_id="w1")


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with ExitStack() as opened:
        yield Place(tmp_path, opened)


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallS3]:
    """A store that serves the logs of a place as `s3://logs`, and takes overlays."""
    with SmallS3(tmp_path) as serving:
        for name, value in serving.environment.items():
            monkeypatch.setenv(name, value)
        yield serving


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {DEADLINE_S:g} s: {what}"
        threading.Event().wait(0.01)


class Told(WorkerObserver):
    """Tells a function of leases that begin and end."""

    def __init__(self, on_lease: Callable[[bool], None]) -> None:
        self._on_lease = on_lease

    def working(self, working: bool) -> None:
        self._on_lease(working)


def work(
    place: Place,
    enough: Callable[[], bool],
    *,
    on_lease: Callable[[bool], None] = lambda _: None,
    metrics: WorkerMetrics | None = None,
) -> None:
    """Let a worker work until there is enough, then stop it."""
    stop = threading.Event()

    def watch() -> None:
        try:
            until(enough, "enough work done")
        finally:
            stop.set()

    watching = threading.Thread(target=watch)
    watching.start()
    Worker(place.session, place.config, stop=stop, observer=Told(on_lease), metrics=metrics).run()
    watching.join()
    assert enough()


def states(place: Place) -> dict[str, int]:
    return place.world.ledger.status().shards_by_state


def test_a_worker_plans_mines_and_commits_records_that_came_over_the_bus(place: Place) -> None:
    work(place, lambda: states(place) == {"done": 2})
    scenes = place.world.ledger.current_scenes()
    assert [scene.seq for scene in scenes] == [1, 2]
    assert scenes[0].decoded().frames == 20
    status = place.world.ledger.status()
    assert status.frames == 40
    assert status.bytes_needed > 0
    assert len(list(place.logs.parent.glob("overlays/**/*.overlay"))) == 2


def test_a_log_that_is_replaced_in_mid_run_is_planned_anew(place: Place) -> None:
    replaced = False

    def on_lease(working: bool) -> None:
        nonlocal replaced
        if not working and not replaced:  # just planned
            place.write_log("a", seconds=6)
            replaced = True

    work(place, lambda: states(place) == {"done": 3}, on_lease=on_lease)
    assert replaced
    assert len(place.world.ledger.current_scenes()) == 3


def test_a_log_that_cannot_be_mined_is_refused_and_the_others_go_on(place: Place) -> None:
    (place.logs / "b.mcap").write_bytes(b"this is no MCAP file")
    ledger = place.world.ledger

    def enough() -> bool:
        return {log.log_id: log.state for log in ledger.status().logs} == {
            "a": "done",
            "b": "refused",
        }

    work(place, enough)


def test_a_bug_is_told_to_the_ledger_and_then_ends_the_worker(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("workers.worker.lease_execution.plan_recording", broken)
    with pytest.raises(ZeroDivisionError):
        Worker(place.session, place.config, stop=threading.Event()).run()
    place.world.clock.now_s += 3600.0
    grant = place.world.claim()
    assert isinstance(grant, PlanLease), "it is tried again"


def test_a_lease_is_renewed_for_as_long_as_it_is_kept(place: Place) -> None:
    lease, clock = _claimed(place), place.world.clock
    with LeaseKeeper(place.leases(), lease, stop=threading.Event(), drain_s=0.0) as keeper:
        for _ in range(4):
            clock.now_s += 20.0  # of the 30 that a lease lasts
            until(lambda: _expires_s(place) >= clock.now_s + 29.0, "a renewal")
            place.world.ledger.expire()
            keeper.check()
    clock.now_s += 31.0
    assert place.world.ledger.expire() == 1


def test_whoever_lost_a_lease_stops_working_on_it(place: Place) -> None:
    lease = _claimed(place)
    with LeaseKeeper(place.leases(), lease, stop=threading.Event(), drain_s=0.0) as keeper:
        keeper.check()
        place.world.ledger.free_leases("w1")
        assert keeper.over.wait(DEADLINE_S)
        assert not keeper.drained.is_set(), "a finished shard may still be committed"
        with pytest.raises(LeaseLostError):
            keeper.check()


def test_whoever_is_told_to_stop_may_finish_what_is_soon_done(place: Place) -> None:
    lease, stop = _claimed(place), threading.Event()
    with LeaseKeeper(place.leases(), lease, stop=stop, drain_s=0.5) as keeper:
        stop.set()
        assert not keeper.over.wait(0.2)
        keeper.check()
        assert keeper.over.wait(DEADLINE_S)
        with pytest.raises(StoppedError):
            keeper.check()


class Counts:
    """What a worker counted, and what its ledger holds against it."""

    def __init__(self, place: Place) -> None:
        self.metrics, self.place = WorkerMetrics(), place

    def __call__(self, name: str, **labels: str) -> float:
        value = self.metrics.registry.get_sample_value(f"counterpoint_worker_{name}", labels)
        assert value is not None, f"no such series: {name} {labels}"
        return value

    def nothing_held_against_anything(self) -> bool:
        from sqlalchemy import select

        from service.store.tables import PLANS, SHARDS

        with self.place.world.store.reading() as connection:
            return not any(
                row.attempts or row.state == "parked"
                for table in (PLANS, SHARDS)
                for row in connection.execute(select(table.c.attempts, table.c.state))
            )


def test_credentials_that_expire_in_mid_run_cost_no_attempt_and_are_waited_out(
    tmp_path: Path, opened: ExitStack, store: SmallS3
) -> None:
    place = Place(tmp_path, opened, seconds=2, bucket="s3://logs")
    counted = Counts(place)
    leases = 0

    def on_lease(working: bool) -> None:
        nonlocal leases
        leases += working
        if leases == 2 and working:
            store.refuses.add("/")
            renewing = threading.Thread(target=renew)
            renewing.start()
            opened.callback(renewing.join)

    def renew() -> None:
        until(lambda: counted("waiting_for_store", store="bucket") == 1, "a worker that waits")
        store.refuses.clear()

    work(place, lambda: states(place) == {"done": 1}, on_lease=on_lease, metrics=counted.metrics)
    assert counted("store_errors_total", store="bucket", kind="refused") == 1
    assert counted("shards_total", outcome="store_away") == 1
    assert counted("shards_total", outcome="committed") == 1
    assert counted("waiting_for_store", store="bucket") == 0
    assert counted.nothing_held_against_anything()


def test_an_object_that_alone_is_forbidden_is_its_own_logs_problem(
    tmp_path: Path, opened: ExitStack, store: SmallS3
) -> None:
    place = Place(tmp_path, opened, seconds=2, bucket="s3://logs")
    place.write_log("b", seconds=2)
    store.refuses.add("b.mcap")
    counted = Counts(place)

    def enough() -> bool:
        found = {log.log_id: log.state for log in place.world.ledger.status().logs}
        return found == {"a": "done", "b": "parked"}

    work(place, enough, metrics=counted.metrics)
    assert counted("plans_total", outcome="failed") == 1
    assert counted("plans_total", outcome="store_away") == 0


def test_overlays_that_nobody_may_write_park_nothing_and_are_waited_out(
    tmp_path: Path, opened: ExitStack, store: SmallS3
) -> None:
    place = Place(tmp_path, opened, seconds=2, artifacts="s3://overlays")
    counted = Counts(place)
    store.refuses.add("PUT ")

    def allow() -> None:
        until(lambda: counted("waiting_for_store", store="artifacts") == 1, "a worker that waits")
        store.refuses.clear()

    allowing = threading.Thread(target=allow)
    allowing.start()
    work(place, lambda: states(place) == {"done": 1}, metrics=counted.metrics)
    allowing.join()
    assert counted("store_errors_total", store="artifacts", kind="refused") == 1
    assert counted("scenes_total") == 2, "one was mined in vain"
    assert counted.nothing_held_against_anything()
    assert len(list((tmp_path / "overlays").rglob("*.overlay"))) == 1


def test_an_upload_in_progress_is_given_back_and_planned_as_soon_as_it_is_whole(
    tmp_path: Path, opened: ExitStack
) -> None:
    place = Place(tmp_path, opened, seconds=2, settle_s=3600.0)
    counted = Counts(place)
    whole = (place.logs / "a.mcap").read_bytes()
    (place.logs / "b.mcap").write_bytes(whole[: len(whole) // 2])

    def finish() -> None:
        until(lambda: counted("plans_total", outcome="growing") >= 1, "a log that still grows")
        place.write_log("b", seconds=2)

    finishing = threading.Thread(target=finish)
    finishing.start()
    work(place, lambda: states(place) == {"done": 2}, metrics=counted.metrics)
    finishing.join()
    assert counted("plans_total", outcome="committed") == 2
    assert counted("truncated_parts_total") == 0
    assert counted.nothing_held_against_anything()


def test_a_log_cut_off_for_good_is_mined_as_far_as_it_goes_and_said_so_in_one_line(
    tmp_path: Path, opened: ExitStack
) -> None:
    place = Place(tmp_path, opened, seconds=3)
    whole = (place.logs / "a.mcap").read_bytes()
    (place.logs / "a.mcap").write_bytes(whole[: len(whole) * 7 // 10])
    counted = Counts(place)
    with capture_logs() as said:
        work(place, lambda: set(states(place)) == {"done"}, metrics=counted.metrics)
    (line,) = [each for each in said if each["event"].startswith("truncated object")]
    assert (line["key"], line["bytes"]) == ("a.mcap", len(whole) * 7 // 10)
    assert 1.5 < line["seconds"] < 3.0
    assert counted("truncated_parts_total") == 1


def run_until_stopped(place: Place, metrics: WorkerMetrics, begun: Callable[[], None]) -> bool:
    """Run a worker, stop it in the middle of its second lease, and wait for its end.

    Args:
        place: Where it works.
        metrics: Where it counts.
        begun: Called when the lease has begun, before the stop.

    Returns:
        Whether it ended by itself.
    """
    stop, leases = threading.Event(), 0

    def on_lease(working: bool) -> None:
        nonlocal leases
        leases += working
        if leases == 2 and working:
            begun()
            stop.set()

    worker = Worker(
        place.session, place.config, stop=stop, observer=Told(on_lease), metrics=metrics
    )
    running = threading.Thread(target=worker.run, daemon=True)
    running.start()
    running.join(DEADLINE_S)
    return not running.is_alive()


def test_a_router_that_goes_and_comes_back_is_seen_and_said(opened: ExitStack) -> None:
    endpoint = free_endpoint()
    router = router_session([endpoint])
    session = opened.enter_context(client_session([endpoint]))
    seen: list[bool] = []
    with capture_logs() as said, RouterWatch(session, seen.append):
        until(lambda: seen == [True], "a router")
        router.close()  # type: ignore[no-untyped-call]
        until(lambda: seen == [True, False], "its loss")
        opened.enter_context(router_session([endpoint]))
        until(lambda: seen == [True, False, True], "its return")
    assert [each["event"] for each in said] == ["router lost: waiting for it", "router is back"]


def test_a_drain_ends_though_the_router_is_gone(tmp_path: Path, opened: ExitStack) -> None:
    place = Place(tmp_path, opened, seconds=2, drain_s=1.0)
    counted = Counts(place)
    assert run_until_stopped(place, counted.metrics, place.cut_off)
    assert counted("shards_total", outcome="given_back") == 1


def test_a_drain_ends_though_the_bucket_does_not_answer(
    tmp_path: Path, opened: ExitStack, store: SmallS3
) -> None:
    place = Place(tmp_path, opened, seconds=2, bucket="s3://logs", drain_s=1.0)
    counted = Counts(place)

    def stall() -> None:
        store.stalls = True

    assert run_until_stopped(place, counted.metrics, stall)
    assert counted("shards_total", outcome="given_back") == 1
    assert counted.nothing_held_against_anything()


def _claimed(place: Place) -> PlanLease:
    """Claim the plan, to be renewed every tenth of a second."""
    grant = place.world.claim()
    assert isinstance(grant, PlanLease)
    return grant.model_copy(update={"expires_s": 0.3})


def _expires_s(place: Place) -> float:
    from sqlalchemy import select

    from service.store.tables import LEASES

    with place.world.store.reading() as connection:
        return float(connection.execute(select(LEASES.c.expires_s)).scalar_one())
