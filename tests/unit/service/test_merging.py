"""Live scenes and history, merged, whatever order and losses the bus comes up with."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from service.merging import SceneEvent, SceneMerge

PAGE = 3


class Past:
    """A history that can be cut short, as by a service killed while it answers."""

    def __init__(self, *events: SceneEvent) -> None:
        self.events = list(events)
        self.cut_after: int | None = None
        self.asked = 0

    def __call__(self, asked: dict[str, int]) -> Iterator[SceneEvent]:
        self.asked += 1
        if "newest" in asked:
            return iter(self.events[-asked["newest"] :])
        newer = (event for event in self.events if event.seq > asked["since"])
        return islice(newer, asked["most"] if self.cut_after is None else self.cut_after)


def scene(seq: int, name: str = "", digest: str = "") -> SceneEvent:
    name = name or f"s{seq}"
    return SceneEvent(seq, f"log/lidar/{name}", b"{}", digest or f"digest of {name}")


def test_the_history_comes_whole_although_it_takes_several_pages() -> None:
    past = Past(*(scene(seq) for seq in range(1, 12)))
    assert list(SceneMerge(past, page=PAGE).begin(None)) == past.events


def test_only_the_newest_few_come_when_only_they_are_wanted() -> None:
    past = Past(*(scene(seq) for seq in range(1, 12)))
    merge = SceneMerge(past, page=PAGE)
    assert list(merge.begin(2)) == past.events[-2:]
    assert list(merge.catch_up()) == []
    assert list(merge.take(scene(4))) == [], "an old scene put again by a restarted service"


def test_no_past_at_all_means_none_and_still_what_is_new() -> None:
    past = Past(scene(1), scene(2))
    merge = SceneMerge(past, page=PAGE)
    assert list(merge.begin(0)) == []
    assert list(merge.take(scene(2))) == []
    assert list(merge.take(scene(3))) == [scene(3)]


def test_a_scene_that_comes_both_ways_is_given_once() -> None:
    past = Past(scene(1), scene(2))
    merge = SceneMerge(past, page=PAGE)
    list(merge.begin(None))
    assert list(merge.take(scene(2))) == []
    assert list(merge.take(scene(3))) == [scene(3)]
    assert list(merge.take(scene(3))) == []


def test_a_gap_in_the_numbers_is_fetched_before_what_showed_it() -> None:
    past = Past(scene(1))
    merge = SceneMerge(past, page=PAGE)
    list(merge.begin(None))
    past.events += [scene(2), scene(3), scene(4)]
    assert list(merge.take(scene(4))) == [scene(2), scene(3), scene(4)]


def test_a_gap_that_cannot_be_fetched_now_is_fetched_when_it_is_quiet() -> None:
    past = Past(scene(1))
    merge = SceneMerge(past, page=PAGE)
    list(merge.begin(None))
    past.events += [scene(2), scene(3), scene(4)]
    past.cut_after = 0
    assert list(merge.take(scene(4))) == [scene(4)]
    past.cut_after = None
    assert list(merge.catch_up()) == [scene(2), scene(3)]
    asked = past.asked
    assert list(merge.take(scene(5))) == [scene(5)]
    assert past.asked == asked, "nothing is missing, nothing is asked"


def test_numbers_of_scenes_that_are_no_longer_current_are_no_gap_for_ever() -> None:
    past = Past(scene(1), scene(9))
    merge = SceneMerge(past, page=PAGE)
    assert list(merge.begin(None)) == [scene(1), scene(9)]
    asked = past.asked
    assert list(merge.take(scene(10))) == [scene(10)]
    assert past.asked == asked


def test_a_withdrawal_is_given_and_so_is_the_scene_when_it_comes_back() -> None:
    past = Past(scene(1, "a"))
    merge = SceneMerge(past, page=PAGE)
    list(merge.begin(None))
    gone = SceneEvent(2, "log/lidar/a")
    assert list(merge.take(gone)) == [gone]
    assert gone.withdrawn
    assert gone.score is None
    assert list(merge.take(scene(3, "a"))) == [scene(3, "a")]


def test_an_old_record_put_again_does_not_replace_a_newer_one() -> None:
    merge = SceneMerge(Past(), page=PAGE)
    assert list(merge.take(scene(1, "a", "old")))
    assert list(merge.take(scene(2, "a", "new")))
    assert list(merge.take(scene(1, "a", "old"))) == []


def test_whatever_is_lost_doubled_or_cut_short_every_scene_comes_exactly_once() -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        past = Past()
        merge = SceneMerge(past, page=PAGE)
        given = list(merge.begin(None))
        for seq in range(1, 40):
            past.events.append(scene(seq))
            past.cut_after = [None, 0, 1, 2][rng.integers(4)]
            for _ in range(int(rng.choice([0, 1, 1, 2]))):
                given += merge.take(scene(seq))
        past.cut_after = None
        given += merge.catch_up()
        assert sorted(event.seq for event in given) == list(range(1, 40)), f"seed {seed}"
