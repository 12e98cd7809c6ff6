"""ROS message definitions as data: which fields a message has, in which order and of which type.

Box messages changed their fields between releases, so the definition in the log decides. It is
parsed here and interpreted by `ros_values`; no text of a log is ever run as code.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

MAX_DEFINITION: Final = 131_072
"""Characters of a definition; those of Autoware with all members have 20,000."""

MAX_DEPTH: Final = 16
"""Messages within messages."""

MAX_FIXED: Final = 4_096
"""Elements of an array of fixed length; a covariance has 36."""

PRIMITIVES: Final[Mapping[str, str]] = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Name of a type to its code in `struct`."""

_TIMES: Final = ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration")
_FIELD: Final = re.compile(
    r"^([A-Za-z][A-Za-z0-9_/]*)(<=\d+)?(\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)(\s+[^=\s].*)?$"
)
_SEPARATOR: Final = re.compile(r"^=+\s*$", re.MULTILINE)


class DefinitionUnreadableError(ValueError):
    """A definition that cannot be used; the message is a clause without an end."""


@dataclass(frozen=True, slots=True)
class FieldType:
    """One field of a message.

    Attributes:
        name: Its name.
        code: Code in `struct` of a primitive, `s` for text, `t` for a time; empty for a message.
        members: Fields of a message.
        length: None for a single value, -1 for a sequence, else elements of an array.
    """

    name: str
    code: str
    members: "tuple[FieldType, ...]"
    length: int | None


def parse_definition(text: str, type_name: str) -> tuple[FieldType, ...]:
    """Parse a definition with those of its members appended, as recorders store it.

    Args:
        text: Definition of ROS 1 or of ROS 2 (`ros1msg`, `ros2msg`).
        type_name: Its type, `package/Type`.

    Raises:
        DefinitionUnreadableError: If it cannot be read, or a message has no field.
    """
    if len(text) > MAX_DEFINITION:
        raise DefinitionUnreadableError(
            f"it has {len(text)} characters, more than {MAX_DEFINITION}"
        )
    root, *others = _SEPARATOR.split(text)
    known = {type_name: root}
    for other in others:
        first, _, body = other.strip().partition("\n")
        known[first.removeprefix("MSG:").strip().replace("/msg/", "/")] = body
    return _members(type_name, known, depth=0)


def _members(type_name: str, known: Mapping[str, str], *, depth: int) -> tuple[FieldType, ...]:
    if depth > MAX_DEPTH:
        raise DefinitionUnreadableError(f"it nests more than {MAX_DEPTH} messages")
    if type_name not in known:
        raise DefinitionUnreadableError(f"it does not define {type_name[:80]}")
    found: list[FieldType] = []
    for raw in known[type_name].splitlines():
        line = raw.partition("#")[0].strip()
        if not line or re.match(r"^\S+\s+\w+\s*=", line):
            continue  # a comment or a constant
        matched = _FIELD.match(line)
        if matched is None:
            raise DefinitionUnreadableError(f"it has the line {line[:80]!r}")
        kind, _, array, bounded, count, name, _ = matched.groups()
        found.append(_field(kind, name, _length(array, bounded, count), type_name, known, depth))
    if not found:
        raise DefinitionUnreadableError(f"{type_name[:80]} has no field")
    return tuple(found)


def _length(array: str | None, bounded: str | None, count: str) -> int | None:
    if not array:
        return None
    if bounded or not count:
        return -1
    if not 0 < int(count) <= MAX_FIXED:
        raise DefinitionUnreadableError(f"it has an array of {count[:20]} elements")
    return int(count)


def _field(
    kind: str, name: str, length: int | None, within: str, known: Mapping[str, str], depth: int
) -> FieldType:
    kind = kind.replace("/msg/", "/")
    if kind in PRIMITIVES:
        return FieldType(name, PRIMITIVES[kind], (), length)
    if kind == "string":
        return FieldType(name, "s", (), length)
    if kind in _TIMES:
        return FieldType(name, "t", (), length)
    if kind == "Header":
        kind = "std_msgs/Header"
    elif "/" not in kind:
        kind = f"{within.partition('/')[0]}/{kind}"
    return FieldType(name, "", _members(kind, known, depth=depth + 1), length)
