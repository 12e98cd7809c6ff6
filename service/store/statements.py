"""Statements of the hot path, compiled once for each kind of server and run by its driver.

SQLAlchemy generates them, so that they fit the tables and the dialect of either server. Running
them through it would cost several times what the database takes.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Delete, Insert, Select, Update
from sqlalchemy.engine import Dialect


class Statement:
    """One statement with named parameters, all of them text, numbers, flags or bytes.

    Errors of the driver are not wrapped here; `Store` translates them.
    """

    def __init__(self, statement: Select[Any] | Insert | Update | Delete) -> None:
        """Keep a statement whose parameters are `bindparam`s, or the columns of an insert."""
        self._statement = statement
        self._compiled: dict[str, _Compiled] = {}

    def rows(self, connection: Connection, parameters: Mapping[str, Any]) -> list[Any]:
        """Run it in the transaction of this connection.

        Returns:
            Rows with their columns by name, as the driver reads them: a flag of SQLite is 0 or 1.
            Empty for a statement that returns none.
        """
        compiled = self._for(connection.dialect)
        cursor = connection.connection.cursor()
        try:
            cursor.execute(compiled.text, compiled.bound(parameters))
            return [] if compiled.row is None else [compiled.row(*row) for row in cursor.fetchall()]
        finally:
            cursor.close()

    def one(self, connection: Connection, parameters: Mapping[str, Any]) -> Any:
        """Run it and return the row, where there is exactly one."""
        (row,) = self.rows(connection, parameters)
        return row

    def first(self, connection: Connection, parameters: Mapping[str, Any]) -> Any | None:
        """Run it and return its first row, None where there is none."""
        return next(iter(self.rows(connection, parameters)), None)

    def run_each(self, connection: Connection, parameters: Sequence[Mapping[str, Any]]) -> None:
        """Run it once for each set of parameters."""
        compiled = self._for(connection.dialect)
        cursor = connection.connection.cursor()
        try:
            cursor.executemany(compiled.text, [compiled.bound(each) for each in parameters])
        finally:
            cursor.close()

    def _for(self, dialect: Dialect) -> "_Compiled":
        compiled = self._compiled.get(dialect.name)
        if compiled is None:
            compiled = self._compiled[dialect.name] = _compile(self._statement, dialect)
        return compiled


@dataclass(frozen=True, slots=True)
class _Compiled:
    """A statement compiled for one driver.

    Attributes:
        text: SQL with the driver's placeholders.
        constants: Values that the statement itself contains.
        order: Names by position, for a driver with positional parameters; None for named ones.
        row: Makes a row of its columns; None for a statement that returns none.
    """

    text: str
    constants: dict[str, Any]
    order: tuple[str, ...] | None
    row: Callable[..., Any] | None

    def bound(self, parameters: Mapping[str, Any]) -> Any:
        values = {**self.constants, **parameters} if self.constants else parameters
        return values if self.order is None else tuple(map(values.__getitem__, self.order))


def _compile(statement: Select[Any] | Insert | Update | Delete, dialect: Dialect) -> _Compiled:
    compiled = statement.compile(dialect=dialect)
    columns = [column.keyname for column in compiled._result_columns]
    return _Compiled(
        text=str(compiled),
        constants={name: value for name, value in compiled.params.items() if value is not None},
        order=tuple(compiled.positiontup or ()) if compiled.positional else None,
        row=namedtuple("Row", columns) if columns else None,
    )
