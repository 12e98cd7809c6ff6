"""Subscribers written from the wire page alone: it leaves nothing out, and what it says is so."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
import zenoh
import zenoh.ext

from schemas.transport.ask import PROBLEM
from schemas.transport.bus import RANKED, RECORD, client_session
from service.client import ControlClient
from tests.contracts.ledger_world import expected_scenes
from tests.integration.running import ROOT, Running, two_logs, until

pytestmark = pytest.mark.integration

SUBSCRIBER = Path(__file__).with_name("wire_subscriber.py")


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    with two_logs(tmp_path) as parts:
        yield parts


@contextmanager
def subscriber(endpoint: str, *, after: int = 0) -> Iterator[IO[bytes]]:
    """What a subscriber writes that was made from the page; killed at the end."""
    with subprocess.Popen(
        [sys.executable, str(SUBSCRIBER), endpoint, str(after)], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        try:
            yield process.stdout
        finally:
            process.kill()


def rows(written: IO[bytes], count: int) -> list[dict[str, Any]]:
    return [json.loads(written.readline()) for _ in range(count)]


def test_the_subscriber_made_from_the_page_uses_nothing_of_ours() -> None:
    imported = set()
    for node in ast.walk(ast.parse(SUBSCRIBER.read_text())):
        if isinstance(node, ast.Import):
            imported |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            imported.add(node.module.split(".")[0])
    assert imported <= sys.stdlib_module_names | {"zenoh"}


def test_a_subscriber_made_from_the_page_gets_every_event_through_kills(running: Running) -> None:
    world = running.world
    world.mine_all()
    with subscriber(running.endpoint) as written:
        noted = rows(written, 18)
        running.stop_router()
        running.add_log("c")
        until(lambda: running.log_ids() == {"a", "b", "c"}, "the new log to be listed")
        world.mine_all()
        world.ledger.mark_published(world.ledger.last_seq())  # as if all puts had been lost
        running.start_router()
        noted += rows(written, 9)
    (running.logs / "a.mcap").unlink()
    until(lambda: running.log_ids() == {"b", "c"}, "the deletion to be listed")
    with subscriber(running.endpoint, after=noted[-1]["seq"]) as written:
        noted += rows(written, 9)
        (running.logs / "b.mcap").unlink()
        noted += rows(written, 9)
    assert [row["seq"] for row in noted] == list(range(1, 46)), "every event once, in order"
    came = {row["scene_id"]: row["record"]["scene_id"] for row in noted if row["record"]}
    gone = {row["scene_id"] for row in noted if row["record"] is None}
    assert came == {name: name for name in expected_scenes(["a", "b", "c"])}
    assert gone == set(expected_scenes(["a", "b"]))


def test_a_stock_subscriber_hears_of_withdrawals_and_gets_current_scenes_only(
    running: Running,
) -> None:
    running.world.mine_all()
    (running.logs / "a.mcap").unlink()
    until(lambda: len(running.world.ledger.current_scenes()) == 9, "the deletion")
    until(lambda: running.world.ledger.status().published_seq == 27, "its publication")
    samples: list[tuple[int, zenoh.SampleKind]] = []

    def take(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        samples.append((json.loads(sample.attachment.to_bytes())["seq"], sample.kind))

    with (
        client_session([running.endpoint]) as session,
        zenoh.ext.declare_advanced_subscriber(
            session, f"{ROOT}/v1/scene/**", take, history=zenoh.ext.HistoryConfig()
        ),
    ):
        until(lambda: len(samples) == 9, "the history")
        assert samples == [(seq, zenoh.SampleKind.PUT) for seq in range(10, 19)]
        (running.logs / "b.mcap").unlink()
        until(lambda: len(samples) == 18, "the withdrawals")
    assert samples[9:] == [(seq, zenoh.SampleKind.DELETE) for seq in range(28, 37)]


def test_the_parameters_of_the_history_mean_what_the_page_says(running: Running) -> None:
    running.world.mine_all()
    (running.logs / "a.mcap").unlink()
    until(lambda: running.world.ledger.last_seq() == 27, "the withdrawals")
    put, gone = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE
    current = [(seq, put) for seq in range(10, 19)]
    withdrawn = [(seq, gone) for seq in range(19, 28)]
    with client_session([running.endpoint]) as session:

        def asked(parameters: str, *, scenes: str = "**") -> list[tuple[int, zenoh.SampleKind]]:
            replies = session.get(
                f"{ROOT}/v1/scene/{scenes}?{parameters}",
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            samples = [reply.ok for reply in replies if reply.ok is not None]
            return [
                (json.loads(sample.attachment.to_bytes())["seq"], sample.kind)
                for sample in samples
                if sample.attachment is not None
            ]

        assert asked("since=0") == asked("") == current
        assert asked("since=13") == current[4:]
        assert asked("since=16;withdrawn=1") == current[7:] + withdrawn
        assert asked("since=16;withdrawn=1;most=5") == (current[7:] + withdrawn)[:5]
        assert asked("since=27;withdrawn=1") == []
        assert asked("newest=2") == current[-2:]
        assert asked("since=0;withdrawn=1;most=4", scenes="a/*") == withdrawn[:4]
        assert asked("since=0", scenes="b/*") == current


@pytest.mark.parametrize("parameters", ["since=28", "since=later", "most=-1"])
def test_a_question_that_cannot_be_answered_gets_a_problem(
    running: Running, parameters: str
) -> None:
    with client_session([running.endpoint]) as session:
        (reply,) = session.get(f"{ROOT}/v1/scene/**?{parameters}")
    assert reply.err is not None
    assert reply.err.encoding == PROBLEM
    problem = json.loads(reply.err.payload.to_bytes())
    assert problem["transient"] is False
    assert problem["problem"]


def test_what_is_published_says_what_it_is(running: Running) -> None:
    page = (Path(__file__).parents[2] / "schemas" / "WIRE.md").read_text(encoding="utf-8")
    running.world.mine_all()
    ControlClient([running.endpoint], root=ROOT).select(budget=1, name="week 47")
    with client_session([running.endpoint]) as session:
        for key, encoding in (("scene/**?most=1", RECORD), ("selected/week%2047/**", RANKED)):
            (reply,) = session.get(f"{ROOT}/v1/{key}")
            assert reply.ok is not None
            assert reply.ok.encoding == encoding
            assert f"`{encoding}`" in page
