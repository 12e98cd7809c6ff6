"""Conditions of the listing on the strong tracks of a scene: one track passes all of them."""

from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    and_,
    bindparam,
    false,
    func,
    or_,
    select,
)

from service.curation.listing import ScenesRequest, is_class
from service.curation.ranges import RangeBits, bits_between
from service.store.tables import LISTED_SCENES, LISTED_TRACKS, LISTING_FINDINGS, LISTING_THINGS

_SETS: Final = {"kind": "kinds", "class_name": "class_names", "wrong": "wrongs"}
"""Columns of things, and those of findings with the sets of their values."""


def of_tracks(connection: Connection, request: ScenesRequest) -> list[ColumnElement[bool]]:
    """Return the conditions on a row of the listing that filters of tracks make.

    A single filter is a condition on that row alone. Several ones are about the same track, and
    read the rows of the tracks.
    """
    named = {
        "kind": request.kind,
        "class_name": request.class_name,
        "wrong": request.wrong.value if request.wrong else None,
    }
    given = {name: value for name, value in named.items() if value is not None}
    bits = None
    if request.beyond_m is not None or request.within_m is not None:
        bits = bits_between(request.beyond_m, request.within_m)
    if not given:
        return [] if bits is None else [_within(LISTED_SCENES, bits)]
    if len(given) == 1 and bits is None:
        return [_of_finding(connection, *given.popitem())]
    named_class, things = given.pop("class_name", None), LISTING_THINGS.c
    wanted = and_(True, *(things[name] == value for name, value in given.items()))
    found = connection.execute(select(things.thing, things.class_name).where(wanted))
    numbers = [
        row.thing
        for row in found
        if named_class is None or is_class(row.class_name, wanted=named_class)
    ]
    tracks = select(LISTED_TRACKS.c.seq).where(in_numbers(LISTED_TRACKS.c.thing, numbers))
    if bits is not None:
        tracks = tracks.where(_within(LISTED_TRACKS, bits))
    return [LISTED_SCENES.c.seq.in_(tracks)]


def _of_finding(connection: Connection, name: str, value: str) -> ColumnElement[bool]:
    findings = LISTING_FINDINGS.c
    numbers: set[int] = set()
    for each in _spellings(connection, value) if name == "class_name" else [value]:
        wanted = contains(connection, findings[_SETS[name]], f"|{each}|")
        numbers.update(connection.execute(select(findings.finding).where(wanted)).scalars())
    return in_numbers(LISTED_SCENES.c.finding, sorted(numbers))


def _spellings(connection: Connection, class_name: str) -> list[str]:
    """Return the classes that a name means in any case; databases know that of few letters."""
    known = connection.execute(select(LISTING_THINGS.c.class_name).distinct()).scalars()
    return [each for each in known if is_class(each, wanted=class_name)]


def _within(table: FromClause, bits: RangeBits) -> ColumnElement[bool]:
    columns = (table.c.near_ranges, table.c.far_ranges)
    wanted = zip(columns, bits, strict=True)
    return or_(*(column.bitwise_and(some) != 0 for column, some in wanted if some))


def in_numbers(column: ColumnElement[Any], numbers: Sequence[int]) -> ColumnElement[bool]:
    """Return a condition with the numbers in its text, of which a database bounds no count."""
    if not numbers:
        return false()
    return column.in_(bindparam(None, list(numbers), expanding=True, literal_execute=True))


def contains(connection: Connection, column: ColumnElement[Any], part: str) -> ColumnElement[bool]:
    """Return the condition that a text contains this part."""
    if connection.dialect.name == "sqlite":
        return func.instr(column, part) > 0
    return func.strpos(column, part) > 0
