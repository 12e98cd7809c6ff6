"""ROS messages as dictionaries, by their definition; fields that place no box are skipped."""

import struct
from collections.abc import Sequence
from typing import Any, Final

from schemas.arrays import NS_PER_S
from workers.ingest.boxes.definition import FieldType

SKIPPED: Final = frozenset(
    {
        "covariance",
        "predicted_paths",
        "source_cloud",
        "footprint",
        "acceleration_with_covariance",
        "initial_acceleration_with_covariance",
    }
)
"""Fields of box messages that take most of their bytes and place no box."""

_SIZES: Final = {code: struct.calcsize(f"={code}") for code in "?Bbhiqfd"} | {
    "H": 2,
    "I": 4,
    "Q": 8,
}


def read_ros(
    data: bytes | memoryview, members: Sequence[FieldType], *, cdr: bool, most: int
) -> dict[str, Any]:
    """Read a message into a dictionary; times become nanoseconds.

    Args:
        data: Its payload.
        members: Its fields.
        cdr: True for ROS 2 (CDR, with alignment), false for ROS 1.
        most: Elements that a sequence of messages may have.

    Raises:
        ValueError: If bytes are missing, a sequence is too long, or the encoding is unknown.
        struct.error: If bytes are missing.
    """
    if not cdr:
        return _Reader(memoryview(data), "<", aligned=False, most=most).message(members)
    view = memoryview(data)
    if len(view) < 4 or view[0] != 0 or view[1] not in (0, 1):
        raise ValueError("the payload begins with no header of plain CDR")
    order = "<" if view[1] == 1 else ">"
    return _Reader(view[4:], order, aligned=True, most=most).message(members)


class _Reader:
    def __init__(self, view: memoryview, order: str, *, aligned: bool, most: int) -> None:
        self._view = view
        self._order = order
        self._aligned = aligned
        self._most = most
        self._at = 0

    def message(self, members: Sequence[FieldType]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for each in members:
            if each.name in SKIPPED:
                self._pass_over(each)
            else:
                found[each.name] = self._value(each)
        return found

    def _value(self, each: FieldType) -> Any:
        if each.length is None:
            return self._single(each)
        count = self._count(each)
        if each.code and each.code not in "st":
            if not count:
                return ()  # an empty sequence is not aligned
            self._align(each.code)
            size = _SIZES[each.code] * count
            if self._at + size > len(self._view):
                raise ValueError(f"{each.name} has {count} elements, more than there are bytes")
            values = struct.unpack_from(f"{self._order}{count}{each.code}", self._view, self._at)
            self._at += size
            return values
        if count > self._most:
            raise ValueError(f"{each.name} has {count} elements, more than {self._most}")
        return [self._single(each) for _ in range(count)]

    def _single(self, each: FieldType) -> Any:
        if not each.code:
            return self.message(each.members)
        if each.code == "s":
            return self._text()
        if each.code == "t":
            seconds, nanoseconds = self._number("I"), self._number("I")
            return seconds * NS_PER_S + nanoseconds
        return self._number(each.code)

    def _pass_over(self, each: FieldType) -> None:
        count = 1 if each.length is None else self._count(each)
        if not count:
            return
        if each.code and each.code not in "st":
            self._align(each.code)
            self._at += _SIZES[each.code] * count
        else:
            run = _run(each)
            if run is not None:
                self._align(run[0])
                self._at += _SIZES[run[0]] * run[1] * count
            else:
                self._pass_over_each(each, count)
        if self._at > len(self._view):
            raise ValueError(f"{each.name} is longer than the message")

    def _pass_over_each(self, each: FieldType, count: int) -> None:
        for _ in range(count):
            if each.code == "s":
                length = self._number("I")
                self._at += length
            elif each.code == "t":
                self._align("I")
                self._at += 8
            else:
                for member in each.members:
                    self._pass_over(member)
            if self._at > len(self._view):
                raise ValueError(f"{each.name} is longer than the message")

    def _count(self, each: FieldType) -> int:
        return int(self._number("I")) if each.length == -1 else int(each.length or 0)

    def _number(self, code: str) -> Any:
        self._align(code)
        (value,) = struct.unpack_from(f"{self._order}{code}", self._view, self._at)
        self._at += _SIZES[code]
        return value

    def _text(self) -> str:
        length = int(self._number("I"))
        if self._at + length > len(self._view):
            raise ValueError("a text is longer than the message")
        text = bytes(self._view[self._at : self._at + length]).rstrip(b"\0")
        self._at += length
        return text.decode("utf-8", errors="replace")

    def _align(self, code: str) -> None:
        if self._aligned:
            size = _SIZES[code]
            self._at += -self._at % size


def _run(each: FieldType) -> tuple[str, int] | None:
    """Return code and number of the numbers of a message that has one kind of them, such as a pose.

    Elements of such a message follow each other without gaps, aligned or not.
    """
    found: list[tuple[str, int]] = []
    for member in each.members:
        if member.length == -1 or member.code in ("s", "t"):
            return None
        inner = (member.code, 1) if member.code else _run(member)
        if inner is None:
            return None
        found.append((inner[0], inner[1] * (member.length or 1)))
    if not found or len({code for code, _ in found}) > 1:
        return None
    return found[0][0], sum(count for _, count in found)
