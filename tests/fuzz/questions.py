"""Requests of every kind that anybody might put on the bus, derived from the messages themselves.

A question is a valid message, one made of the fields' types, or no message at all; then values deep
inside are replaced by ones that no message should hold, and now and then its bytes are damaged.
"""

import json
import re
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from pydantic import BaseModel

from service.api.verbs import VERBS

NAMES: Final = ("$LEASE", "$LOG", "$SCENE", "$WORKER", "$VERSION")
"""Stand for what the service knows when the question is asked."""


class Raw(float):
    """Text that goes into the JSON as it is, such as a number that no float holds."""

    def __new__(cls, _: str) -> "Raw":
        return super().__new__(cls, 0.0)

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text if len(self.text) < 40 else f"{self.text[:37]}..."


WILD: Final[tuple[Any, ...]] = (
    None, True, False, 0, -1, 1, 2**31, 2**63 - 1, 2**63, -(2**63) - 1, 2**64, 10**400,
    Raw("1" + 5000 * "0"), Raw("NaN"), Raw("Infinity"), Raw("-Infinity"), Raw("1e999"),
    Raw("-0"), Raw("1e-999"), 0.1, 1e308, 5e-324,
    "", " ", "\0", "a\0b", "\ud800", "\udfff\ud800", "x" * 70_000, "x" * 5_000, "\n\r\t\x1b[31m",
    "\u202e\ufeff", "\U0001f697" * 100, "**", "@adv", "$*", "a//b", "/", "../..", "#?", "%00",
    "1e5", "nan", "null", "'; DROP TABLE scenes; --", "{\"a\": 1}",
    [], {}, [[]], [None], {"": None}, ["x"] * 5_000, {str(n): n for n in range(2_000)},
    Raw("[" * 300 + "]" * 300), Raw("[" * 100_000 + "]" * 100_000), Raw('{"a":' * 5_000 + "1"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Question:
    """A question before it is asked.

    Attributes:
        asked: The verb, or another queryable of the service.
        base: The message; a name in capitals is replaced, and `$COMMIT` by a commit that is right.
        spoilt: Which value within it, counted round, becomes which.
        damage: What becomes of its bytes.
        parameters: Of the selector.
    """

    asked: str
    base: Any
    spoilt: tuple[tuple[int, Any], ...] = ()
    damage: str = "none"
    parameters: str = ""

    def __str__(self) -> str:
        spoilt = ", ".join(f"value {number} by {wild!r:.60}" for number, wild in self.spoilt)
        return (
            f"{self.asked}?{self.parameters:.60} of {self.base!r:.100}, spoilt: {spoilt or 'no'}, "
            f"bytes: {self.damage}"
        )


Change = Callable[[bytes], bytes]

DAMAGES: Final[Mapping[str, Change]] = {
    "none": lambda payload: payload,
    "empty": lambda _: b"",
    "cut": lambda payload: payload[: len(payload) // 2],
    "twice": lambda payload: payload + payload,
    "key twice": lambda payload: payload.replace(b"{", b'{"worker_id":1,"budget":[],', 1),
    "every key twice": lambda payload: payload[:-1] + b"," + payload[1:],
    "marked": lambda payload: b"\xef\xbb\xbf" + payload,
    "not UTF-8": lambda payload: payload[:-2] + b"\xff\xfe" + payload[-2:],
    "NUL": lambda payload: payload + b"\0",
    "unescaped": lambda payload: re.sub(
        rb"\\u([0-9a-f]{4})",
        lambda found: chr(int(found[1], 16)).encode("utf-8", "surrogatepass"),
        payload,
    ),
    "UTF-16": lambda payload: payload.decode(errors="replace").encode("utf-16"),
    "padded": lambda payload: b" " * 1_000_000 + payload,
    "in a list": lambda payload: b"[" + payload + b"]",
    "deep": lambda payload: b"[" * 1_000_000,
    "deep objects": lambda payload: b'{"a":' * 200_000,
    "bytes": lambda payload: bytes(range(256)) * 40,
    "large": lambda payload: b'{"worker_id":"' + b"x" * 10_000_000 + b'"}',
    "large list": lambda payload: b"[" + b"0," * 2_000_000 + b"0]",
    "large manifest": lambda _: (
        b'{"worker_id":"w","lease_id":"l","manifest":[' + b"0," * 2_000_000 + b"0]}"
    ),
    "unknown fields": lambda _: (
        b"{" + b",".join(b'"name-%07d":0' % number for number in range(200_000)) + b"}"
    ),
}


RIGHT: Final = (
    Question("history", ""),
    Question("top", {}),
    Question("select", {"budget": 3}),
    Question("rates", {"by": "vehicle"}),
    Question("commit", "$COMMIT"),
    Question(
        "fail",
        {"worker_id": "$WORKER", "lease_id": "$LEASE", "error": "no such topic", "permanent": True},
    ),
)
"""Questions that are right: a service that has been asked everything else still answers them."""


WRONG: Final = (
    Question("top", {"most": -1}),
    Question("select", {"budget": 0}),
    Question("rates", {"by": "moon"}),
    Question("commit", {}),
    Question("fail", {"worker_id": "$WORKER"}),
)
"""Questions that are wrong, so that each verb of `RIGHT` is asked a wrong one in every run."""


EACH: Final = tuple(Question(verb, {}) for verb in VERBS)
"""Empty questions, so that each verb is asked in every run, however many verbs there are."""


def questions() -> SearchStrategy[Question]:
    """Make questions of every kind."""
    verbs = [_of_verb(verb, kind.request) for verb, kind in VERBS.items()]
    return st.one_of(*verbs, _right_commits(), _right_commits(), _history())


def payload_of(value: Any, spoilt: tuple[tuple[int, Any], ...], damage: str) -> bytes:
    """Lay a message out in JSON, spoilt and damaged."""
    for number, wild in spoilt:
        value = _replaced(value, number, wild)
    text = json.dumps(value, default=repr, cls=_Encoder)
    return DAMAGES[damage](text.encode("utf-8", "surrogatepass"))


class _Encoder(json.JSONEncoder):
    """Lets raw text through."""

    def iterencode(self, o: Any, _one_shot: bool = False) -> Any:
        raw: list[str] = []

        def marked(value: Any) -> Any:
            if isinstance(value, Raw):
                raw.append(value.text)
                return f"\1{len(raw) - 1}\1"
            if isinstance(value, dict):
                return {key: marked(each) for key, each in value.items()}
            if isinstance(value, (list, tuple)):
                return [marked(each) for each in value]
            return value

        text = "".join(super().iterencode(marked(o), _one_shot))
        for number, each in enumerate(raw):
            text = text.replace(f'"\\u0001{number}\\u0001"', each)
        return [text]

    def encode(self, o: Any) -> str:
        return "".join(self.iterencode(o))


def _replaced(value: Any, number: int, wild: Any) -> Any:
    """Replace one value within a tree, counted in the order that it is laid out in."""
    places = list(_places(value))
    if not places:
        return wild
    path = places[number % len(places)]
    return _set(value, path, wild)


def _places(value: Any, path: tuple[Any, ...] = ()) -> Any:
    if path:
        yield path
    children: Any = ()
    if isinstance(value, dict):
        children = value.items()
    elif isinstance(value, (list, tuple)):
        children = enumerate(value)
    for key, child in children:
        yield from _places(child, (*path, key))


def _set(value: Any, path: tuple[Any, ...], wild: Any) -> Any:
    key, *rest = path
    child = _set(value[key], tuple(rest), wild) if rest else wild
    if isinstance(value, dict):
        return {**value, key: child}
    return [*value[:key], child, *value[key + 1 :]]


def spoilings() -> SearchStrategy[tuple[tuple[int, Any], ...]]:
    """Choose none, one or two values of a message, and what each becomes."""
    one = st.tuples(st.integers(0, 400), st.sampled_from(WILD))
    return st.one_of(st.just(()), st.tuples(one), st.tuples(one), st.tuples(one, one))


def damages() -> SearchStrategy[str]:
    """Choose what becomes of the bytes of a message, mostly nothing."""
    return st.one_of(st.just("none"), st.just("none"), st.sampled_from(sorted(DAMAGES)))


def _of_verb(verb: str, message: type[BaseModel] | None) -> SearchStrategy[Question]:
    base = st.sampled_from(WILD) if message is None else messages_of(message)
    return st.builds(Question, st.just(verb), base, spoilings(), damages())


def _right_commits() -> SearchStrategy[Question]:
    """A commit of a lease that is held, right but for what is spoilt."""
    one = st.tuples(st.integers(0, 400), st.sampled_from(WILD))
    spoilt = st.one_of(st.just(()), st.tuples(one), st.tuples(one, one))
    return st.builds(Question, st.just("commit"), st.just("$COMMIT"), spoilt, damages())


def _history() -> SearchStrategy[Question]:
    numbers = (
        "0", "1", "-1", "99999999", str(2**63 - 1), str(2**63), str(2**64), "9" * 5_000, "", "x",
        "1.5", "٣", "²", "NaN", "1e3", "0x10", " 1", "\ud800".encode("utf-8", "ignore").decode(),
    )  # fmt: skip
    names = ("since", "most", "newest", "withdrawn", "_max", "_time", "other")
    pair = st.builds("{}={}".format, st.sampled_from(names), st.sampled_from(numbers))
    parameters = st.lists(pair, max_size=3).map(";".join)
    asked: SearchStrategy[str] = st.sampled_from(("history", "selected", "cache"))
    return st.builds(
        Question, asked, st.just(""), st.just(()), st.just("none"), parameters=parameters
    )


def messages_of(kind: type[BaseModel]) -> SearchStrategy[Any]:
    """Make messages of a kind, by the types of its fields and not by their bounds."""
    required: dict[str, SearchStrategy[Any]] = {}
    optional: dict[str, SearchStrategy[Any]] = {}
    for name, field in kind.model_fields.items():
        there = required if field.is_required() else optional
        there[name] = _value(field.annotation, name)
    return st.fixed_dictionaries(required, optional=optional)


def _value(annotation: Any, name: str) -> SearchStrategy[Any]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _value(arguments[0], name)
    if origin in (Union, types.UnionType):
        return st.one_of(*(_value(each, name) for each in arguments))
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(_value(arguments[0], name), max_size=3)
    if origin is tuple:
        return st.tuples(*(_value(each, name) for each in arguments)).map(list)
    if origin in (dict, Mapping):
        return st.dictionaries(_text(name), _value(arguments[1], name), max_size=3)
    if annotation is type(None):
        return st.none()
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return messages_of(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return st.sampled_from([each.value for each in annotation])
    plain: Mapping[Any, SearchStrategy[Any]] = {
        bool: st.booleans(),
        int: st.one_of(st.integers(0, 100), st.integers(0, 2**63 - 1), st.integers()),
        float: st.floats(),
        str: _text(name),
    }
    return plain[annotation]


def _text(name: str) -> SearchStrategy[str]:
    known = {
        "lease_id": "$LEASE",
        "worker_id": "$WORKER",
        "log_id": "$LOG",
        "log_ids": "$LOG",
        "scene_id": "$SCENE",
        "pipeline_version": "$VERSION",
    }
    some = st.text(st.characters(), max_size=20)
    return st.one_of(st.just(known.get(name, "car-7")), st.just(known.get(name, "/lidar")), some)
