"""Live scenes and history, merged, whatever order and losses the bus comes up with."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from schemas.canonical import sha256
from schemas.transport.wire import encode_scene_score
from service.client.merge import Holding, SceneEvent, SceneMerge, Wanted
from tests.contracts.ledger_world import START_NS, score_of

PAGE = 3


class Past:
    """A history that can be cut short, as by a service killed while it answers.

    Like the real one it remembers the last event of each scene alone.
    """

    def __init__(self, *events: SceneEvent) -> None:
        self._last: dict[str, SceneEvent] = {}
        self.cut_after: int | None = None
        self.asked = 0
        for event in events:
            self.add(event)

    def add(self, event: SceneEvent) -> None:
        self._last[event.scene_id] = event

    @property
    def events(self) -> list[SceneEvent]:
        return sorted(self._last.values(), key=lambda event: event.seq)

    def __call__(self, asked: Mapping[str, int]) -> Sequence[SceneEvent]:
        self.asked += 1
        if "newest" in asked:
            return [event for event in self.events if not event.withdrawn][-asked["newest"] :]
        assert asked["withdrawn"] == 1
        newer = [event for event in self.events if event.seq > asked["since"]]
        return newer[: asked["most"] if self.cut_after is None else self.cut_after]


def scene(seq: int, name: str = "", digest: str = "") -> SceneEvent:
    name = name or f"s{seq}"
    return SceneEvent(seq, f"log/lidar/{name}", b"{}", digest or f"digest of {name}")


def gone(seq: int, name: str) -> SceneEvent:
    return SceneEvent(seq, f"log/lidar/{name}")


def scored(seq: int, *, log_id: str = "car-1/a", score: float = 0.5, at: int = 0) -> SceneEvent:
    """A scene with a record, of the vehicle bus-7."""
    decoded = score_of(log_id, START_NS + at, score=score)
    record = encode_scene_score(decoded)
    return SceneEvent(seq, decoded.scene_id, record, sha256(record), decoded)


def withdrawal(seq: int, of: SceneEvent) -> SceneEvent:
    return SceneEvent(seq, of.scene_id)


# In order, each once.


def test_the_history_comes_whole_although_it_takes_several_pages() -> None:
    past = Past(*(scene(seq) for seq in range(1, 12)))
    assert list(SceneMerge(past, page=PAGE).catch_up()) == past.events


def test_whoever_resumes_gets_only_what_came_after() -> None:
    past = Past(*(scene(seq) for seq in range(1, 12)), gone(12, "s3"))
    merge = SceneMerge(past, page=PAGE, since=9)
    assert list(merge.catch_up()) == [scene(10), scene(11), gone(12, "s3")]


def test_only_the_newest_few_come_when_only_they_are_wanted() -> None:
    past = Past(*(scene(seq) for seq in range(1, 12)))
    merge = SceneMerge(past, page=PAGE)
    assert merge.begin(2) == past.events[-2:]
    assert list(merge.catch_up()) == []
    merge.hear(4)
    assert not merge.is_behind, "an old scene put again by a restarted service"


def test_no_past_at_all_means_none_and_still_what_is_new() -> None:
    past = Past(scene(1), scene(2))
    merge = SceneMerge(past, page=PAGE)
    assert merge.begin(0) == []
    merge.hear(2)
    assert not merge.is_behind
    past.add(scene(3))
    merge.hear(3)
    assert list(merge.catch_up()) == [scene(3)]


def test_an_empty_answer_is_told_from_none_wanted() -> None:
    assert SceneMerge(Past(), page=PAGE).begin(0) is None


def test_a_scene_that_comes_both_ways_is_given_once() -> None:
    past = Past(scene(1), scene(2))
    merge = SceneMerge(past, page=PAGE)
    list(merge.catch_up())
    past.add(scene(3))
    merge.hear(3)
    assert list(merge.catch_up()) == [scene(3)]
    merge.hear(3)
    assert not merge.is_behind
    assert list(merge.catch_up()) == []


def test_what_comes_beyond_a_gap_waits_for_what_is_missing() -> None:
    past = Past(scene(1))
    merge = SceneMerge(past, page=PAGE)
    list(merge.catch_up())
    for seq in (2, 3, 4):
        past.add(scene(seq))
    past.cut_after = 0
    merge.hear(4)
    assert merge.is_behind
    assert list(merge.catch_up()) == []
    assert merge.complete_to == 1, "who is killed now must not resume after 4"
    past.cut_after = None
    assert list(merge.catch_up()) == [scene(2), scene(3), scene(4)]
    assert not merge.is_behind


def test_numbers_of_events_that_others_made_void_are_no_gap_for_ever() -> None:
    merge = SceneMerge(Past(scene(1), scene(9)), page=PAGE)
    merge.hear(9)
    assert list(merge.catch_up()) == [scene(1), scene(9)]
    assert not merge.is_behind


def test_a_made_up_number_is_forgotten_and_never_gone_on_from() -> None:
    past = Past(scene(1))
    merge = SceneMerge(past, page=PAGE)
    merge.hear(2**63 - 1)
    assert list(merge.catch_up()) == [scene(1)]
    assert not merge.is_behind
    past.add(scene(2))
    merge.hear(2)
    assert list(merge.catch_up()) == [scene(2)]


def test_a_record_that_cannot_be_read_is_passed_over_by_its_number() -> None:
    past = Past(scene(1), SceneEvent(2, "log/lidar/s2", b"?", unreadable=True), scene(3))
    merge = SceneMerge(past, page=1)
    assert list(merge.catch_up()) == [scene(1), scene(3)]


@pytest.mark.parametrize("seed", range(50))
def test_whatever_is_lost_doubled_or_cut_short_a_subscriber_ends_with_what_is_current(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    past = Past()
    life = _Life(past, since=0)
    current: dict[str, int] = {}
    held: dict[str, int] = {}
    last = 0

    def handle(events: Sequence[SceneEvent]) -> None:
        nonlocal last
        for event in events:
            assert event.seq > last, "in the order of their numbers, none twice"
            last = event.seq
            if event.withdrawn:
                held.pop(event.scene_id, None)
            else:
                held[event.scene_id] = event.seq

    for seq in range(1, 60):
        name = f"s{rng.integers(12)}"
        event = gone(seq, name) if f"log/lidar/{name}" in current else scene(seq, name)
        past.add(event)
        if event.withdrawn:
            del current[event.scene_id]
        else:
            current[event.scene_id] = seq
        past.cut_after = [None, 0, 1, 2][rng.integers(4)]
        for _ in range(int(rng.choice([0, 1, 1, 2]))):
            handle(life.send(event))
        if rng.random() < 0.1:  # killed, and started again after the last number it has noted
            life = _Life(past, since=last)
    past.cut_after = None
    handle(life.send(None))
    assert held == current


class _Life:
    """One life of a subscriber: what the client does with what the bus brings."""

    def __init__(self, past: Past, *, since: int) -> None:
        self._merge = SceneMerge(past, page=PAGE, since=since)

    def send(self, event: SceneEvent | None) -> list[SceneEvent]:
        if event is not None:
            self._merge.hear(event.seq)
        if event is None or self._merge.is_behind:
            return list(self._merge.catch_up())
        return []


# What is news.


def test_a_withdrawal_is_news_and_so_is_the_scene_when_it_comes_back() -> None:
    came = scored(1)
    assert _news(came, withdrawal(2, came), scored(3)) == [1, 2, 3]


def test_the_same_record_again_is_no_news() -> None:
    assert _news(scored(1), scored(5)) == [1]
    assert _news(scored(1), scored(5, score=0.6)) == [1, 5]


def test_a_withdrawal_is_told_once_and_only_of_what_was_given() -> None:
    came = scored(1)
    assert _news(withdrawal(2, came)) == []
    assert _news(came, withdrawal(2, came), withdrawal(9, came)) == [1, 2]


def test_whoever_resumes_hears_of_withdrawals_of_what_an_earlier_life_may_have_had() -> None:
    came = scored(1)
    assert _news(withdrawal(2, came), withdrawal(9, came), resumed=True) == [2]
    assert _news(withdrawal(2, came), scored(3), withdrawal(9, came), resumed=True) == [2, 3, 9]
    other = Wanted(log="car-2/*")
    assert _news(withdrawal(2, came), wanted=other, resumed=True) == []


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        pytest.param(Wanted(), [1, 2, 3], id="everything"),
        pytest.param(Wanted(log="car-1/*"), [1, 3], id="a pattern of logs"),
        pytest.param(Wanted(log="car-1"), [], id="the pattern must match whole"),
        pytest.param(Wanted(log="*/b"), [2], id="a star crosses slashes"),
        pytest.param(Wanted(min_score=0.5), [2, 3], id="a least score"),
        pytest.param(Wanted(vehicles=frozenset({"bus-7"})), [1, 2, 3], id="a vehicle"),
        pytest.param(Wanted(vehicles=frozenset({"bus-8"})), [], id="another vehicle"),
        pytest.param(Wanted(log="car-1/*", min_score=0.9), [3], id="both"),
    ],
)
def test_only_what_is_wanted_is_news(wanted: Wanted, expected: list[int]) -> None:
    events = (
        scored(1, score=0.2, at=1),
        scored(2, log_id="car-2/x/b", score=0.5),
        scored(3, score=0.9, at=2),
    )
    assert _news(*events, wanted=wanted) == expected


def test_a_scene_that_is_no_longer_wanted_is_taken_back() -> None:
    holding = Holding(Wanted(min_score=0.5), resumed=False)
    assert holding.news(scored(1, score=0.8)) is not None
    news = holding.news(scored(2, score=0.3))
    assert news is not None
    assert (news.seq, news.withdrawn, news.score) == (2, True, None)
    assert holding.news(scored(3, score=0.2)) is None, "it was taken back before"
    assert holding.news(scored(4, score=0.9)) is not None


def test_an_event_names_its_log() -> None:
    assert scored(1, log_id="car-7/2026-11-20/drive").log_id == "car-7/2026-11-20/drive"


def _news(*events: SceneEvent, wanted: Wanted | None = None, resumed: bool = False) -> list[int]:
    holding = Holding(wanted or Wanted(), resumed=resumed)
    return [news.seq for event in events if (news := holding.news(event)) is not None]
