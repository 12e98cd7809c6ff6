"""A service that is killed while it delivers webhooks: every event arrives, in order."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from service.curation.comparison import ComparedSide, CompareRequest
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.contracts.test_comparisons_contract import two_versions
from tests.free_ports import free_endpoint
from tests.integration.running import until
from tests.unit.service.mined_state import mined_state
from tests.webhook_receiver import SECRET, Receiver, receiver

pytestmark = pytest.mark.integration

MIN_SCORE = 0.3


@contextmanager
def service(
    folder: Path, env: Mapping[str, str]
) -> Iterator[tuple["subprocess.Popen[bytes]", str]]:
    """Run router and service on an empty bucket until the end of the block."""
    (folder / "logs").mkdir(exist_ok=True)
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "service.cli"]
    serve = ["service", "--bucket", str(folder / "logs"), "--state", str(folder / "state")]
    settings = os.environ | {"COUNTERPOINT_HTTP_LISTEN": "", "COUNTERPOINT_SETTLE_S": "600"}
    settings |= env
    router = subprocess.Popen([*command, "router", "--listen", endpoint])
    served = subprocess.Popen([*command, *serve, "--connect", endpoint], env=settings)
    try:
        yield served, endpoint
    finally:
        for process in (served, router):
            process.kill()
            process.wait()


def answers(client: ControlClient) -> bool:
    try:
        return client.status() is not None
    except TransientError:
        return False


def scene_ids(one: Receiver) -> list[str]:
    return [data["scene_id"] for data in one.of("scene.new")]


def test_a_service_that_is_killed_delivers_every_event_at_least_once(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(SECRET)
    with receiver() as one:
        env = {
            "COUNTERPOINT_WEBHOOKS": one.url,
            "COUNTERPOINT_WEBHOOK_SECRET_FILE": str(tmp_path / "secret"),
            "COUNTERPOINT_WEBHOOK_MIN_SCORE": str(MIN_SCORE),
        }
        with service(tmp_path, env) as (process, endpoint):
            client = ControlClient([endpoint], root=DEFAULT_ROOT)
            until(lambda: answers(client), "the service answers")
            process.terminate()
            assert process.wait(30) in (0, 143)
        mined_state(tmp_path / "state")
        one.status = lambda taken: 200 if taken < 2 else 503
        with service(tmp_path, env) as (process, _):
            until(lambda: len(one.ids()) == 2 and one.refused > 0, "two were taken, one refused")
            process.send_signal(signal.SIGKILL)
        one.status = lambda taken: 200
        with service(tmp_path, env) as (_, endpoint):
            client = ControlClient([endpoint], root=DEFAULT_ROOT)
            until(lambda: answers(client), "the service answers")
            wanted = [row.scene_id for row in client.top() if row.score >= MIN_SCORE]
            client.select(budget=1, name="week 47")
            until(lambda: bool(one.of("selection.made")), "the selection came")
            until(lambda: set(scene_ids(one)) == set(wanted), "every scene came")
    assert len(one.ids()) <= len(set(one.ids())) + 1, "only what was in doubt came twice"
    numbers = [data["seq"] for data in one.of("scene.new")]
    assert numbers == sorted(numbers)


def test_a_comparison_that_the_service_answers_is_sent_once(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(SECRET)
    (tmp_path / "state").mkdir()
    store = open_store(tmp_path / "state")
    two_versions(World.on(store))
    store.close()
    older, newer = (ComparedSide(software_version=name) for name in ("2.4", "2.5"))
    with receiver() as one:
        env = {
            "COUNTERPOINT_WEBHOOKS": one.url,
            "COUNTERPOINT_WEBHOOK_SECRET_FILE": str(tmp_path / "secret"),
            "COUNTERPOINT_WEBHOOK_EVENTS": "gate.compared",
        }
        with service(tmp_path, env) as (_, endpoint):
            client = ControlClient([endpoint], root=DEFAULT_ROOT)
            until(lambda: answers(client), "the service answers")
            for a, b in ((older, newer), (older, newer), (newer, older)):
                client.compare(CompareRequest(a=a, b=b))
            until(lambda: len(one.of("gate.compared")) >= 2, "both results came")
    sides = [(data["a"], data["b"]) for data in one.of("gate.compared")]
    assert sides == [("software 2.4", "software 2.5"), ("software 2.5", "software 2.4")]
