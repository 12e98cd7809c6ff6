"""Plays the day of `bucket_day` on real processes, and mines the bucket that it leaves afresh."""

import random
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from schemas.transport.recordings import group_recordings
from tests.free_ports import free_endpoint
from tests.integration.bucket_day import Change, stories
from tests.integration.bucket_hand import Hand
from tests.integration.daemons import System
from tests.integration.day_blows import OF_MINERS, Blow, Blows, blows
from tests.integration.day_glance import Glance
from tests.integration.day_watchers import Watcher, history, stock_subscriber
from tests.integration.evening import Evening, Tally, count_up, found_in, mined_afresh

LIVELY: Final = {
    "COUNTERPOINT_LIST_INTERVAL_S": "0.5",
    "COUNTERPOINT_SETTLE_S": "3",
    "COUNTERPOINT_SUPERVISED": "recorded",
    "COUNTERPOINT_GRID__SCENE_S": "1",
    "COUNTERPOINT_GRID__SHARD_S": "1",
    "COUNTERPOINT_GRID__WARMUP_S": "0.5",
}
"""A day has a minute: everything is short."""

PAUSES_S: Final = (0.1, 1.2)
"""Between two things that happen: less than a listing, or more."""

HEARD_S: Final = 60.0
"""For subscribers to hear the last of it."""


def play(
    folder: Path,
    hand: Hand,
    *,
    seed: int,
    env: Mapping[str, str] | None = None,
    say: Callable[[str], None] = lambda _: None,
    struck: Sequence[Blow] | None = None,
) -> Evening:
    """Live through a day, and mine what it leaves once more from nothing.

    Args:
        folder: For states and logs of the processes.
        hand: Whoever drops logs in the bucket, which is empty in the morning.
        seed: Makes up the day.
        env: How the processes reach the bucket.
        say: Told what happens.
        struck: The blows of the day; None: all of them.
    """
    blows_of_day = blows(hand) if struck is None else struck
    env = {**LIVELY, **(env or {})}
    day = Day(folder, hand, seed=seed, env=env, say=say, struck=blows_of_day)
    try:
        return day.live()
    finally:
        day.end()


class Day:
    """Processes, subscribers, and what happens to all of them."""

    def __init__(
        self,
        folder: Path,
        hand: Hand,
        *,
        seed: int,
        env: Mapping[str, str],
        say: Callable[[str], None],
        struck: Sequence[Blow],
    ) -> None:
        self._folder, self._hand, self._env, self._tell = folder, hand, env, say
        self._struck = tuple(struck)
        self._rng = random.Random(f"day {seed}")  # noqa: S311  # the same seed, the same day
        self._stories = stories(seed)
        http = free_endpoint().removeprefix("tcp/")
        self._system = System(folder, hand.url, env={**env, "COUNTERPOINT_HTTP_LISTEN": http})
        self._tally = Tally()
        self._listed: dict[str, str] = {}
        """Log id to revision, of what lies in the bucket."""
        self._begun_s = time.monotonic()
        self._glance = Glance(self._system.state)
        self._blows = Blows(
            self._system, hand, self._tally, http=http, rng=self._rng, say=self._say
        )
        self._all_day = Watcher(
            self._system.endpoint,
            on_scene=lambda text: self._say("scene", text),
            on_service=lambda there: self._say(
                "scene", "the service is back" if there else "the service is gone"
            ),
        )
        self._away_at_noon = Watcher(self._system.endpoint)
        self._noon = deque((0.35, 0.8))
        """Shares of the day at which he goes and comes back."""

    def live(self) -> Evening:
        """Begin, let everything happen, wait until all is mined, and look."""
        self._say("day", f"begins; {len(self._stories)} logs have something before them")
        self._system.start()
        self._blows.until(lambda: self._system.status() is not None, "an answer")
        for watcher in (self._all_day, self._away_at_noon):
            watcher.start()
        self._let_all_happen()
        self._say("day", "nothing happens any more")
        self._blows.until(self._is_over, "all is mined, and as the stories end")
        evening = self._look()
        self._say("day", f"is over: {len(evening.lived.records)} scenes are current")
        return evening

    def end(self) -> None:
        """Leave nothing running."""
        for watcher in (self._all_day, self._away_at_noon):
            watcher.end()
        self._system.end()
        self._glance.close()

    def _let_all_happen(self) -> None:
        changes = sum(len(story.changes) for story in self._stories)
        going = {story.log_id: deque(story.changes) for story in self._stories}
        kills = deque(self._rng.sample(self._struck, len(self._struck)))
        while going:
            log_id = self._next_of(going)
            self._make(log_id, going[log_id].popleft())
            if not going[log_id]:
                del going[log_id]
            made = self._tally.changes.total()
            self._take_noon_off(made / changes)
            if len(kills) > len(self._struck) * (1 - made / changes):
                self._kill_next(kills)
        while kills:  # of miners, while there was nothing to lose
            self._blows.until(
                lambda: self._glance.sees_mining() or self._is_over(), "something is mined"
            )
            self._kill_next(kills, anyway=True)

    def _next_of(self, going: Mapping[str, deque[Change]]) -> str:
        """Choose a log to which the next thing can happen, or wait until there is one."""
        ready: list[str] = []

        def some_ready() -> bool:
            seen = self._glance.look()
            ready[:] = [
                log_id
                for log_id, changes in going.items()
                if seen.has_come_to(changes[0].after, log_id, revision=self._listed.get(log_id))
            ]
            return bool(ready)

        self._blows.until(some_ready, f"something can happen to one of {sorted(going)}")
        return self._rng.choice(ready)

    def _make(self, log_id: str, change: Change) -> None:
        size = "" if change.data is None else f" ({len(change.data) / 1e6:.2f} MB)"
        self._say("bucket", f"{change.key} {change.kind}{size}")
        if change.data is None:
            self._hand.delete(change.key)
        else:
            self._hand.put(change.key, change.data)
        self._tally.changes[change.kind] += 1
        self._listed = self._of_stories(
            {
                recording.log_id: recording.revision
                for recording in group_recordings(self._hand.open().list())
            }
        )
        time.sleep(self._rng.uniform(*PAUSES_S))

    def _kill_next(self, kills: deque[Blow], *, anyway: bool = False) -> None:
        if kills[0] in OF_MINERS and not anyway and not self._glance.sees_mining():
            kills.rotate(-1)  # its turn comes when there is something to lose
        else:
            self._blows.strike(kills.popleft())

    def _is_over(self) -> bool:
        ends = {story.log_id: story.ends for story in self._stories if story.ends is not None}
        seen = self._glance.look()
        states = {log_id: log.state for log_id, log in seen.logs.items()}
        others = {state for log_id, state in states.items() if log_id not in ends}
        return (
            self._of_stories(seen.revisions) == self._listed
            and self._of_stories(states) == ends
            and others <= {"done", "refused"}
        )

    def _of_stories(self, by_log: Mapping[str, str]) -> dict[str, str]:
        """Leave out what lies in the bucket besides: the service may list or pass over that."""
        known = {story.log_id for story in self._stories}
        return {log_id: value for log_id, value in by_log.items() if log_id in known}

    def _take_noon_off(self, share: float) -> None:
        """Let one subscriber be away while half of the day happens."""
        if self._noon and share > self._noon[0]:
            self._noon.popleft()
            if self._noon:
                self._say("kill", "a subscriber")
                self._tally.kills["subscriber"] += 1
                self._away_at_noon.end()
            else:
                self._say("scene", "the subscriber resumes after the last number he has noted")
                self._away_at_noon.start()

    def _look(self) -> Evening:
        """Ask everybody what is current, end the processes, and mine the bucket afresh."""
        state, endpoint = self._system.state, self._system.endpoint
        late = Watcher(endpoint)
        late.start()
        lived = found_in(state, top=("--connect", endpoint), env=self._env)
        watchers = {
            "who listened all day": self._all_day,
            "who was away at noon": self._away_at_noon,
            "who came in the evening": late,
        }
        end_s = time.monotonic() + HEARD_S
        for watcher in watchers.values():
            while watcher.current != lived.records and time.monotonic() < end_s:
                time.sleep(0.05)
            watcher.end()
            assert watcher.seqs == sorted(set(watcher.seqs)), "an event came twice or too late"
        heard = {who: watcher.current for who, watcher in watchers.items()}
        heard["the history"] = history(endpoint)
        heard["a stock subscriber"] = stock_subscriber(
            endpoint, until=lambda records: records == lived.records
        )
        ended = self._system.stop()
        assert ended == [0, 0, 0], f"processes told to stop end with {ended}"
        assert not (faults := self._blows.faults()), "\n".join(faults)
        count_up(self._tally, state)
        self._say("day", "over; a fresh run mines the bucket as it lies there")
        fresh = mined_afresh(self._folder / "fresh", self._hand.url, env=self._env)
        return Evening(lived, fresh, heard, self._tally, self._all_day.withdrawn)

    def _say(self, who: str, what: str) -> None:
        self._tell(f"{time.monotonic() - self._begun_s:6.1f} s  {who:<7} {what}")
