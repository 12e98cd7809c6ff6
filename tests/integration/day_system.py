"""Plays the day of `bucket_day` on real processes, and mines the bucket that it leaves afresh."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from schemas.keys import DEFAULT_ROOT
from service.client import watch_scenes
from tests.integration.bucket_day import STAYS, Hand, Kills, Step, day
from tests.integration.daemons import QUICK, System

LIVELY = {"COUNTERPOINT_LIST_INTERVAL_S": "0.5", "COUNTERPOINT_SETTLE_S": "3"}
PAUSE_S = 0.7
"""Between two things that happen: more than one listing."""


@dataclass(frozen=True, slots=True)
class Evening:
    """What there is at the end of the day.

    Attributes:
        top: Rows of the ranking, as the daemon that lived through the day gives them.
        fresh: The same from a run that saw only the bucket's last state.
        watched: Scene id to digest, as a subscriber has it who listened all day.
    """

    top: list[dict[str, Any]]
    fresh: list[dict[str, Any]]
    watched: dict[str, str]


class Watcher:
    """A subscriber who listens all day, and keeps what is current."""

    def __init__(self, endpoint: str) -> None:
        self.current: dict[str, str] = {}
        self.withdrawn = 0
        self._endpoint, self._stop = endpoint, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        for event in watch_scenes([self._endpoint], root=DEFAULT_ROOT, stop=self._stop, idle_s=0.5):
            if event.withdrawn:
                self.withdrawn += 1
                self.current.pop(event.scene_id, None)
            else:
                self.current[event.scene_id] = event.sha256


def play(
    folder: Path,
    bucket: str,
    hand: Hand,
    *,
    kill_store: Callable[[], None] = lambda: None,
    env: Mapping[str, str] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Evening:
    """Live through the day, and mine what it leaves once more from nothing.

    Args:
        folder: For states and logs of the processes.
        bucket: URL of the log bucket, empty in the morning.
        hand: Whoever drops logs in it.
        kill_store: Kills the store behind the bucket and starts it again.
        env: How to reach it.
        say: Told what happens.
    """
    env = {**LIVELY, **(env or {})}
    system = System(folder, bucket, "--supervised", "recorded", env=env)
    watcher = Watcher(system.endpoint)
    begun_s = time.monotonic()
    try:
        system.start()
        system.until(lambda: system.status() is not None, "an answer")
        watcher.start()
        kills = Kills(
            service=system.service.restart,
            worker=system.kill_worker,
            router=system.router.restart,
            store=kill_store,
        )
        for step in day(hand, kills):
            say(f"{time.monotonic() - begun_s:5.1f} s  {step.what}")
            _live_through(system, step)
        system.until(lambda: system.states() == STAYS, f"the logs come to {STAYS}")
        rows = [row.model_dump(mode="json") for row in system.client.top()]
        held = {row["scene_id"]: row["sha256"] for row in rows}
        system.until(lambda: watcher.current == held, "the watcher has what is current")
        say(f"{time.monotonic() - begun_s:5.1f} s  the day is over: {len(rows)} scenes")
        watcher.end()
        assert system.stop() == [0, 0, 0]
    finally:
        system.end()
    return Evening(rows, _mined_afresh(folder, bucket, env), watcher.current)


def _live_through(system: System, step: Step) -> None:
    step.happens()
    if step.until is None:
        time.sleep(PAUSE_S)
        return
    log_id, state = step.until
    system.until(lambda: system.states().get(log_id) == state, f"{log_id} is {state}")


def _mined_afresh(folder: Path, bucket: str, env: Mapping[str, str]) -> list[dict[str, Any]]:
    state = str(folder / "fresh")
    command = [sys.executable, "-m", "service.cli.main"]
    once = ["run", "--once", "--supervised", "recorded"]
    surroundings = os.environ | QUICK | dict(env)
    subprocess.run(
        [*command, *once, "--bucket", bucket, "--state", state],
        env=surroundings,
        check=True,
        capture_output=True,
    )
    listed = subprocess.run(
        [*command, "top", "--state", state, "--json"],
        env=surroundings,
        check=True,
        capture_output=True,
        text=True,
    )
    return [json.loads(line) for line in listed.stdout.splitlines()]
