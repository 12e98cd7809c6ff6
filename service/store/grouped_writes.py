"""Group commit: concurrent writers share one transaction, and with it one wait for the disk."""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from threading import Event, Lock
from typing import Any, Final, Generic, TypeVar

from sqlalchemy import Connection

from schemas.errors import CounterpointError
from service.errors import StatementFailedError

Result = TypeVar("Result")

MOST_IN_GROUP: Final = 64
"""Writes per group; bounds the delay of the first, and the disk is shared well before that."""


class GroupedWrites:
    """Groups the writes that arrive while earlier ones are on their way to the disk.

    No write waits for others: one that arrives alone begins at once, and those that arrive
    meanwhile form the next group. One of its writers leads it, so that no thread is needed.
    """

    def __init__(self, transaction: Callable[[], AbstractContextManager[Connection]]) -> None:
        """Keep the function that begins a transaction, which is on disk when its block is left."""
        self._transaction = transaction
        self._waiting: deque[_Write[Any]] = deque()
        self._is_led = False
        self._lock = Lock()

    def do(self, work: Callable[[Connection], Result]) -> Result:
        """Run a write together with other waiting ones; return when it is on disk.

        An error in one write undoes the whole group. Each write is then repeated in a transaction
        of its own, in which only the faulty one fails. A database that accepts no transaction
        refuses all of them.

        Args:
            work: Called again, in another transaction, if the first was undone.

        Raises:
            Exception: Error of the work.
            CounterpointError: If the database refused the transaction.
        """
        write = _Write(work)
        with self._lock:
            self._waiting.append(write)
            leads, self._is_led = not self._is_led, True
        if not leads:
            write.woken.wait()
        if not write.was_in_group:
            self._lead()
        if write.refusal is not None:
            raise type(write.refusal)(str(write.refusal)) from write.refusal
        if write.results:
            return write.results[0]
        with self._transaction() as connection:
            return work(connection)

    def _lead(self) -> None:
        with self._lock:
            group = [self._waiting.popleft() for _ in range(min(len(self._waiting), MOST_IN_GROUP))]
        try:
            self._do_together(group)
        finally:
            for write in group:
                write.was_in_group = True
                write.woken.set()
            with self._lock:
                if self._waiting:
                    self._waiting[0].woken.set()  # it leads those that came meanwhile
                else:
                    self._is_led = False

    def _do_together(self, group: Sequence["_Write[Any]"]) -> None:
        try:
            with self._transaction() as connection:
                results = [write.begin(connection) for write in group]
        except (_UndoneError, StatementFailedError):
            return
        except CounterpointError as error:
            for write in group:
                write.refusal = error
            return
        for write, result in zip(group, results, strict=True):
            write.results.append(result)


class _UndoneError(Exception):
    """A write failed, and with it the transaction of its group."""


@dataclass(eq=False)
class _Write(Generic[Result]):
    """One writer's part of a group.

    Attributes:
        work: The write.
        woken: Set when its group is over, or when it has to lead the next one.
        was_in_group: True if its group is over.
        results: Result of the work, once it is on disk; empty if it was undone.
        refusal: Error for which the database accepted no transaction.
    """

    work: Callable[[Connection], Result]
    woken: Event = field(default_factory=Event)
    was_in_group: bool = False
    results: list[Result] = field(default_factory=list)
    refusal: CounterpointError | None = None

    def begin(self, connection: Connection) -> Result:
        """Run the write within the group's transaction."""
        try:
            return self.work(connection)
        except Exception as error:
            raise _UndoneError from error
