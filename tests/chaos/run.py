"""A run of chaos: blows for a time, then everything healed, finished, and compared."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

from schemas.canonical import sha256
from tests.chaos.blows import Blows
from tests.chaos.parts import Parts
from tests.chaos.street_logs import Undisturbed
from tests.chaos.world import ChaosWorld, chaos_world
from tests.integration.witness import Witness

BACKLOG: Final = 60
STREET_BACKLOG: Final = 9
"""Shards that wait at least, while there is time: a run without work shows nothing. Those of
streets take longer."""

CALM_EVERY: Final = 25
"""Blows between two moments in which everything is healed, and a commit is waited for."""

DEADLINE_S: Final = 240.0
"""Longest wait for a commit in a healed system, and for the end of all work, seconds."""

FAULTS: Final = ("Traceback (most recent", "fault of the program", "panicked at")
"""Words in a log that no kill, freeze, cut or full disk excuses."""


@dataclass(slots=True)
class ChaosReport:
    """Blows of a run of chaos, and the state after it.

    Attributes:
        seed: Of the run.
        parts: Further parts of the system.
        seconds: Length of the blows.
        dealt: Number of each blow.
        killed: Number of kills by kind of process.
        scenes: Number of scenes that an undisturbed run gives.
        logs: Number of logs.
        recoveries_s: Seconds from a healed system to its next commit.
        terms: Number of times that a service took the database.
        problems: What is not as in an undisturbed run; empty: nothing.
    """

    seed: int
    parts: Parts = field(default_factory=Parts)
    seconds: float = 0.0
    dealt: Counter[str] = field(default_factory=Counter)
    killed: Counter[str] = field(default_factory=Counter)
    scenes: int = 0
    logs: int = 0
    recoveries_s: list[float] = field(default_factory=list)
    terms: int = 0
    problems: list[str] = field(default_factory=list)

    def lines(self) -> Iterator[str]:
        """Tell it to a person."""
        kills = f"{self.killed.total()} kills in {self.seconds:.0f} s"
        yield f"seed {self.seed} ({self.parts}): {kills}"
        yield "  blows: " + ", ".join(f"{name} {n}" for name, n in sorted(self.dealt.items()))
        yield "  kills: " + ", ".join(f"{name} {n}" for name, n in sorted(self.killed.items()))
        worst_s = max(self.recoveries_s, default=0.0)
        yield f"  first commit in a healed system after {worst_s:.1f} s at most"
        yield f"  the database was taken {self.terms} times by a service"
        same = "as an undisturbed run" if not self.problems else "NOT as an undisturbed run"
        yield f"  {self.scenes} scenes of {self.logs} logs: {same}"
        for problem in self.problems:
            yield f"  {problem}"


def run_chaos(
    *, seed: int, seconds: float, kills: int | None = None, parts: Parts | None = None
) -> ChaosReport:
    """Deal blows to a system that mines, then compare what it stored and published.

    Args:
        seed: Of the blows.
        seconds: Longest time of the blows.
        kills: Number of kills after which the blows end earlier; None: the time alone ends them.
        parts: Further parts of the system.
    """
    report = ChaosReport(seed, parts or Parts())
    with chaos_world(report.parts, seed=seed) as world:
        pair = world.pair
        pair.start(*pair.names)
        pair.until_done(1, deadline_s=DEADLINE_S)
        with Witness(pair.endpoints) as witness:
            _until(lambda: bool(witness.events), world, "a watcher that sees a scene")
            _rage(world, report, seconds=seconds, kills=kills)
            pair.until_done(pair.shards, deadline_s=DEADLINE_S)
            expected = world.undisturbed()
            _until(
                lambda: len(witness.events) >= len(expected.records), world, "all scenes published"
            )
        report.terms = world.term()
        report.scenes, report.logs = len(expected.records), len(pair.log_ids)
        report.problems += _differences(world, expected, witness)
    return report


def _rage(world: ChaosWorld, report: ChaosReport, *, seconds: float, kills: int | None) -> None:
    blows = Blows(world, seed=report.seed)
    began_s = time.monotonic()
    try:
        while time.monotonic() - began_s < seconds and (kills is None or blows.kills < kills):
            for _ in range(CALM_EVERY):
                blows.step()
            blows.heal()
            report.recoveries_s.append(_next_commit_s(world))
    finally:
        blows.heal()
        report.dealt.update(blows.dealt)
        report.killed.update(blows.killed)
        report.seconds = time.monotonic() - began_s


def _next_commit_s(world: ChaosWorld) -> float:
    """Wait until a healed system commits; return the seconds from its healing."""
    pair = world.pair
    began_s = time.monotonic()
    for name in pair.names:
        assert pair.is_running(name), f"{name} has ended by itself\n{pair.words()}"
    done = -1
    _until(lambda: pair.done() >= 0, world, "a service that answers")
    done = pair.done()
    backlog = BACKLOG if world.parts.pool == "quick" else STREET_BACKLOG
    if pair.shards - done < backlog:
        pair.add_logs(backlog // 4)
    _until(lambda: pair.done() > done, world, "a commit after everything was healed")
    return time.monotonic() - began_s


def _until(condition: Callable[[], bool], world: ChaosWorld, what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, (
            f"not within {DEADLINE_S:g} s: {what}\n{world.pair.words()}"
        )
        time.sleep(0.05)


def _differences(world: ChaosWorld, expected: Undisturbed, witness: Witness) -> Iterator[str]:
    """Name everything in which the system differs from an undisturbed run."""
    pair = world.pair
    try:
        stored = world.stored()
    except AssertionError as error:
        yield str(error)
        return
    if missing := expected.records.keys() - stored.keys():
        yield f"{len(missing)} scenes are lost, such as {min(missing)}"
    if more := stored.keys() - expected.records.keys():
        yield f"{len(more)} scenes are in no undisturbed run, such as {min(more)}"
    if other := [
        each
        for each in stored.keys() & expected.records.keys()
        if stored[each] != expected.records[each]
    ]:
        yield f"{len(other)} records differ, such as {min(other)}"
    if wrong := world.wrong_overlays(expected):
        yield f"{len(wrong)} overlays are missing or differ, such as {min(wrong)}"
    digests = {scene_id: sha256(record) for scene_id, record in expected.records.items()}
    if pair.scenes() != digests:
        yield "the ranking differs"
    seen = Counter(event.scene_id for event in witness.events)
    if twice := [scene_id for scene_id, count in seen.items() if count > 1]:
        yield f"a watcher saw {len(twice)} scenes twice, such as {min(twice)}"
    if {event.scene_id: event.sha256 for event in witness.events} != digests:
        yield "a watcher saw other scenes than were mined"
    if parked := pair.client.status().parked:
        yield f"{len(parked)} pieces of work are parked, such as {parked[0]}"
    for name in pair.names:
        for line in pair.said(name).splitlines():
            if any(words in line for words in FAULTS):
                yield f"{name} said: {line[-3000:]}"
