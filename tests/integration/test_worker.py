"""One worker in this process, on a real router and service: its leases, its errors, its end."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from schemas.bucket import open_bucket
from schemas.bus import client_session, free_endpoint, router_session
from schemas.keys import DEFAULT_ROOT
from schemas.retry import StoppedError
from schemas.work import Grid, MiningSettings, PlanLease
from service.app import Service
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from workers.lease import LeaseKeeper, LeaseLostError, Leases
from workers.simulation.lidar import UNEVEN_64, Lidar
from workers.simulation.worlds import build_street
from workers.simulation.write import write_log
from workers.worker import Worker, WorkerConfig

pytestmark = pytest.mark.integration

DEADLINE_S = 60.0
SMALL = Lidar(elevation_deg=UNEVEN_64[::4], columns=120)


class Place:
    """A bucket of small logs, its service, and a session for a worker."""

    def __init__(self, folder: Path, opened: ExitStack) -> None:
        self.logs = folder / "logs"
        self.logs.mkdir()
        (folder / "state").mkdir()
        self.write_log("a", seconds=4)
        self.world = World.on(open_store(folder / "state"))
        opened.callback(self.world.store.close)
        endpoint = free_endpoint()
        opened.enter_context(router_session([endpoint]))
        settings = MiningSettings(
            bucket=str(self.logs),
            artifacts=str(folder / "overlays"),
            grid=Grid(shard_s=2.0),
            supervised="recorded",
        )
        service = Service(
            opened.enter_context(client_session([endpoint])),
            self.world.ledger,
            bucket=open_bucket(str(self.logs)),
            settings=settings,
            list_interval_s=0.1,
        )
        opened.enter_context(service)
        self.session: zenoh.Session = opened.enter_context(client_session([endpoint]))
        self.config = WorkerConfig("w1", (endpoint,), drain_s=30.0)

    def write_log(self, name: str, *, seconds: float) -> None:
        street = build_street(0, seconds=seconds, style="stands")
        write_log(self.logs / f"{name}.mcap", street, lidar=SMALL)

    def leases(self) -> Leases:
        return Leases(self.session, root=DEFAULT_ROOT, worker_id="w1")


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with ExitStack() as opened:
        yield Place(tmp_path, opened)


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {DEADLINE_S:g} s: {what}"
        threading.Event().wait(0.01)


def work(
    place: Place, enough: Callable[[], bool], *, on_lease: Callable[[bool], None] = lambda _: None
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
    Worker(place.session, place.config, stop=stop, on_lease=on_lease).run()
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

    monkeypatch.setattr("workers.worker.plan_recording", broken)
    with pytest.raises(ZeroDivisionError):
        Worker(place.session, place.config, stop=threading.Event(), on_lease=lambda _: None).run()
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
