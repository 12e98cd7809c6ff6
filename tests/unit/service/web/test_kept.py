"""Answers are asked once at a time, kept for their age, and awaited no longer than wanted."""

import threading

import pytest

from service.web.kept import MOST_KEPT, Kept


def test_an_answer_is_kept_until_it_is_forgotten_or_old() -> None:
    asked: list[int] = []

    def ask() -> int:
        asked.append(1)
        return len(asked)

    kept: Kept[int] = Kept(age_s=1000)
    assert [kept.of("a", ask), kept.of("a", ask), kept.of("b", ask)] == [1, 1, 2]
    kept.forget()
    assert kept.of("a", ask) == 3
    old: Kept[int] = Kept(age_s=0)
    assert [old.of("a", ask), old.of("a", ask)] == [4, 5]


def test_what_is_raised_is_not_kept() -> None:
    kept: Kept[int] = Kept(age_s=1000)
    for ask in (kept.of, lambda q, a: kept.within(q, a, patience_s=5)):
        with pytest.raises(ZeroDivisionError):
            ask("a", lambda: 1 // 0)
    assert kept.of("a", lambda: 7) == 7


def test_threads_that_come_at_once_ask_once() -> None:
    asked: list[int] = []
    go = threading.Event()

    def ask() -> int:
        asked.append(1)
        assert go.wait(10)
        return len(asked)

    kept: Kept[int] = Kept(age_s=1000)
    found: list[int] = []
    threads = [threading.Thread(target=lambda: found.append(kept.of("a", ask))) for _ in range(8)]
    for thread in threads:
        thread.start()
    go.set()
    for thread in threads:
        thread.join()
    assert found == [1] * 8


def test_a_slow_answer_is_there_later_and_an_older_one_meanwhile() -> None:
    kept: Kept[str] = Kept(age_s=0)
    go, ended = threading.Event(), threading.Event()

    def slow() -> str:
        assert go.wait(10)
        ended.set()
        return "slow"

    assert kept.within("a", slow, patience_s=0.01) is None
    assert kept.within("a", slow, patience_s=0.01) is None, "it is not asked twice"
    go.set()
    assert kept.within("a", slow, patience_s=10) == "slow"
    go.clear()
    assert kept.within("a", slow, patience_s=0.01) == "slow", "the older one"
    go.set()
    assert ended.wait(10)


def test_answers_are_bounded() -> None:
    kept: Kept[int] = Kept(age_s=1000)
    for i in range(2 * MOST_KEPT):
        kept.of(i, lambda i=i: i)  # type: ignore[misc]
    assert kept.of(0, lambda: -1) == -1, "the oldest was dropped"
    assert kept.of(2 * MOST_KEPT - 1, lambda: -1) == 2 * MOST_KEPT - 1
