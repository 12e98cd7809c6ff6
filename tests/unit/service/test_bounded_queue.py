"""Requests in a queue: equal ones are answered together, lanes take turns, and room is shared."""

import threading

from service.api.bounded_queue import MOST_ALIKE, Waiting


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def waiting(
    *, most: int = 1000, most_bytes: int = 10**6, clock: Clock | None = None
) -> Waiting[int]:
    return Waiting(most=most, most_bytes=most_bytes, clock=clock or Clock())


def test_equal_questions_are_taken_together_and_others_in_their_order() -> None:
    queue = waiting()
    for number, kind in enumerate(("status", "top", "status", "scene", "status")):
        assert queue.offer(kind, number, size=1) == []
    taken = []
    while (group := queue.take(timeout_s=0)) is not None:
        taken.append(list(group.items))
        queue.done(group)
    assert taken == [[0, 2, 4], [1], [3]]
    assert len(queue) == 0


def test_who_asks_while_it_is_answered_is_served_by_the_next_answer() -> None:
    queue = waiting()
    queue.offer("status", 1, size=1)
    first = queue.take(timeout_s=0)
    assert first is not None
    queue.offer("status", 2, size=1)
    assert queue.take(timeout_s=0) is None, "an answer that was begun before may be too old"
    queue.done(first)
    second = queue.take(timeout_s=0)
    assert second is not None
    assert list(second.items) == [2]


def test_questions_of_one_turn_rest_after_an_answer_and_others_do_not_wait() -> None:
    clock = Clock()
    queue = waiting(clock=clock)
    queue.offer(("top", 1), 1, size=1, turn="top")
    group = queue.take(timeout_s=0)
    assert group is not None
    queue.done(group, rest_s=0.5)
    queue.offer(("top", 2), 2, size=1, turn="top")
    queue.offer("scene", 3, size=1)
    other = queue.take(timeout_s=0)
    assert other is not None
    assert list(other.items) == [3]
    assert queue.take(timeout_s=0) is None
    clock.now_s += 0.5
    later = queue.take(timeout_s=0)
    assert later is not None
    assert list(later.items) == [2]


def test_what_has_no_room_is_sent_back_by_number_bytes_and_likeness() -> None:
    few = waiting(most=2)
    assert [few.offer(number, number, size=0) for number in range(3)] == [[], [], [2]]
    small = waiting(most_bytes=100)
    assert [small.offer(n, n, size=60) for n in range(2)] == [[], [1]]
    assert small.offer(2, 2, size=101, lane="alone") == [2]
    alike = waiting()
    offered = [alike.offer("status", n, size=1) for n in range(MOST_ALIKE + 1)]
    assert offered == [[]] * MOST_ALIKE + [[MOST_ALIKE]]
    assert alike.offer("top", 0, size=1) == []
    group = alike.take(timeout_s=0)
    assert group is not None
    assert alike.offer("status", 0, size=1) == [], "its room is free again"


def test_lanes_are_served_in_turn_however_long_one_is() -> None:
    queue = waiting()
    for number in range(100):
        queue.offer(number, number, size=1, lane="flood")
    for number in range(200, 203):
        queue.offer(number, number, size=1, lane="a worker's lease")
    assert _taken(queue, 6) == [0, 200, 1, 201, 2, 202]
    assert _taken(queue, 2) == [3, 4], "a lane that is empty takes no turn"
    queue.offer(300, 300, size=1, lane="another lease")
    assert _taken(queue, 3) == [5, 300, 6]


def test_a_full_queue_sends_back_the_newest_of_its_longest_lane() -> None:
    queue = waiting(most=10)
    for number in range(8):
        queue.offer(number, number, size=1, lane="flood")
    assert queue.offer(20, 20, size=1, lane="lease") == []
    assert queue.offer(21, 21, size=1, lane="lease") == []
    assert queue.offer(22, 22, size=1, lane="lease") == [7]
    assert queue.offer(8, 8, size=1, lane="flood") == [8], "the longest lane sends back its own"
    assert len(queue) == 10
    assert _taken(queue, 10) == [0, 20, 1, 21, 2, 22, 3, 4, 5, 6]
    assert len(queue) == 0


def test_large_requests_give_way_to_a_lane_with_fewer_bytes() -> None:
    queue = waiting(most_bytes=100)
    assert [queue.offer(n, n, size=30, lane="flood") for n in range(3)] == [[], [], []]
    assert queue.offer(9, 9, size=25, lane="lease") == [2]
    assert queue.offer(3, 3, size=30, lane="flood") == [3]
    assert queue.offer(10, 10, size=70, lane="lease") == [10], "it would be the longest itself"
    assert _taken(queue, 3) == [0, 9, 1]
    assert queue.offer(11, 11, size=100, lane="lease") == [], "all bytes are free again"


def test_equal_questions_are_sent_back_one_by_one() -> None:
    queue = waiting(most=4)
    for number in range(4):
        queue.offer("status", number, size=1, lane="status")
    assert queue.offer("top", 9, size=1, lane="top") == [3]
    group = queue.take(timeout_s=0)
    assert group is not None
    assert list(group.items) == [0, 1, 2]


def _taken(queue: Waiting[int], number: int) -> list[int]:
    taken: list[int] = []
    for _ in range(number):
        group = queue.take(timeout_s=0)
        assert group is not None
        taken += group.items
        queue.done(group)
    return taken


def test_a_thread_that_waits_wakes_for_a_question() -> None:
    queue: Waiting[int] = Waiting(most=10, most_bytes=10)
    timer = threading.Timer(0.05, lambda: queue.offer("x", 7, size=1))
    timer.start()
    group = queue.take(timeout_s=30)
    timer.join()
    assert group is not None
    assert list(group.items) == [7]
