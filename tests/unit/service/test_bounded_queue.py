"""Requests in a queue: equal ones are answered together, and what has no room is sent back."""

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
        assert queue.offer(kind, number, size=1)
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
    assert [few.offer(number, number, size=0) for number in range(3)] == [True, True, False]
    small = waiting(most_bytes=100)
    assert [small.offer(n, n, size=60) for n in range(2)] == [True, False]
    alike = waiting()
    offered = [alike.offer("status", n, size=1) for n in range(MOST_ALIKE + 1)]
    assert offered == [True] * MOST_ALIKE + [False]
    assert alike.offer("top", 0, size=1)
    group = alike.take(timeout_s=0)
    assert group is not None
    assert alike.offer("status", 0, size=1), "its room is free again"


def test_a_thread_that_waits_wakes_for_a_question() -> None:
    queue: Waiting[int] = Waiting(most=10, most_bytes=10)
    timer = threading.Timer(0.05, lambda: queue.offer("x", 7, size=1))
    timer.start()
    group = queue.take(timeout_s=30)
    timer.join()
    assert group is not None
    assert list(group.items) == [7]
