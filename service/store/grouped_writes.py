"""Writers that come at once share one transaction, and with it one wait for the disk."""

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
"""Bounds how long the first of a group waits for the last; the disk is shared well before that."""


class GroupedWrites:
    """Gathers writes while the ones before are on their way to the disk.

    Nobody waits for company: a writer that comes alone begins at once, and those that come
    meanwhile are the next group. One of its writers leads it, so that no thread is needed.
    """

    def __init__(self, transaction: Callable[[], AbstractContextManager[Connection]]) -> None:
        """Take what begins a transaction, which is on disk when its block is left."""
        self._transaction = transaction
        self._waiting: deque[_Write[Any]] = deque()
        self._is_led = False
        self._lock = Lock()

    def do(self, work: Callable[[Connection], Result]) -> Result:
        """Have it done with whatever else is waiting; return when it is on disk.

        What goes wrong in the work of one undoes the whole group, and each of it is done again in
        a transaction of its own, where the one at fault fails alone. A database that takes no
        transaction at all refuses every one of them.

        Args:
            work: Called again, in another transaction, if the first was undone.

        Raises:
            Exception: What the work raised.
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
    """The work of one went wrong, and with it the transaction of all."""


@dataclass(eq=False)
class _Write(Generic[Result]):
    """One writer's part of a group.

    Attributes:
        work: What it wants done.
        woken: Set when its group is over, or when it has to lead the next one.
        was_in_group: Whether its group is over.
        results: What the work returned, once it is on disk; empty if it was undone.
        refusal: Why the database took no transaction.
    """

    work: Callable[[Connection], Result]
    woken: Event = field(default_factory=Event)
    was_in_group: bool = False
    results: list[Result] = field(default_factory=list)
    refusal: CounterpointError | None = None

    def begin(self, connection: Connection) -> Result:
        """Do the work, as part of the group's transaction."""
        try:
            return self.work(connection)
        except Exception as error:
            raise _UndoneError from error
