"""Every number, text and list of every message has a bound, so that none can end its reader."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

import schemas
from schemas.bounds import (
    MAX_COMMIT_BYTES,
    MAX_KEY_BYTES,
    MAX_LOG_ID,
    MAX_NAME,
    MAX_SCENE_ID,
    MAX_SCENES_OF_A_SHARD,
    MAX_TEXT,
    Text,
)
from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys
from schemas.transport.wire import encode
from schemas.work import CommitRequest, LogPlan, ManifestEntry
from service.api.messages import AboutReply
from service.api.verbs import VERBS
from workers.worker.lease import Verb


def _messages() -> set[type[BaseModel]]:
    """Every model of `schemas`, and what the verbs of the service take and answer."""
    found: set[type[BaseModel]] = set()
    for module in pkgutil.iter_modules(schemas.__path__, "schemas."):
        for _, each in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if issubclass(each, BaseModel) and each.__module__.startswith("schemas"):
                found.add(each)
    for verb in VERBS.values():
        found |= {kind for kind in (verb.request, verb.reply) if kind is not None}
    return found


def _name(message: type[BaseModel]) -> str:
    return message.__name__


def _unbounded(node: Any, path: str, definitions: dict[str, Any]) -> Iterator[str]:
    """Yield the paths of what has no bound in a core schema of pydantic."""
    if isinstance(node, list):
        for each in node:
            yield from _unbounded(each, path, definitions)
        return
    if not isinstance(node, dict):
        return
    kind = node.get("type")
    if problem := _problem(kind, node):
        yield f"{path}: {problem}"
    for name, below in node.items():
        if name in {"metadata", "serialization", "ref", "cls", "default"}:
            continue
        if name == "fields":
            for field, about in below.items():
                yield from _unbounded(about, f"{path}.{field}", definitions)
        else:
            yield from _unbounded(below, path, definitions)


def _problem(kind: Any, node: dict[str, Any]) -> str:
    lower, upper = node.keys() & {"ge", "gt"}, node.keys() & {"le", "lt"}
    match kind:
        case "int" if not (lower and upper):
            return "an integer without bounds"
        case "float" if node.get("allow_inf_nan", True) and not (lower and upper):
            return "a float that may be infinite or NaN"
        case "str" if "max_length" not in node:
            return "a text without a bound"
        case "list" | "set" | "frozenset" | "dict" | "generator" if "max_length" not in node:
            return f"a {kind} without a bound"
        case "tuple" if "variadic_item_index" in node and "max_length" not in node:
            return "a list without a bound"
        case "tuple" if node.get("max_length", 0) > MAX_SCENES_OF_A_SHARD and not node.get(
            "fail_fast"
        ):
            return "a long list that keeps an error for each item"
        case "any" | "bytes" | "json":
            return f"of type {kind}"
    return ""


MESSAGES: list[type[BaseModel]] = sorted(_messages(), key=_name)


@pytest.mark.parametrize("message", MESSAGES)
def test_every_field_of_a_message_has_a_bound(message: type[BaseModel]) -> None:
    schema: dict[str, Any] = dict(TypeAdapter(message).core_schema)
    assert list(_unbounded(schema, message.__name__, {})) == []


def test_a_field_without_a_bound_is_found() -> None:
    class Loose(BaseModel):
        number: int = Field(ge=0)
        share: float = 0.0
        text: str | None = None
        words: tuple[str, ...] = ()
        counts: dict[str, int] = Field(default_factory=dict)
        many: tuple[bool, ...] = Field(max_length=10**6)

    class Holds(BaseModel):
        loose: tuple[Loose]

    found = set(_unbounded(dict(TypeAdapter(Holds).core_schema), "", {}))
    assert found == {
        ".loose.number: an integer without bounds",
        ".loose.share: a float that may be infinite or NaN",
        ".loose.text: a text without a bound",
        ".loose.words: a list without a bound",
        ".loose.many: a long list that keeps an error for each item",
        ".loose.words: a text without a bound",
        ".loose.counts: a dict without a bound",
        ".loose.counts: a text without a bound",
        ".loose.counts: an integer without bounds",
    }


def test_the_longest_names_make_keys_that_the_bus_takes() -> None:
    widest = "\U0001f697"  # four bytes, twelve characters of a key
    log_id, name = widest * MAX_LOG_ID, widest * MAX_NAME
    scene_id = widest * MAX_SCENE_ID
    root = "r" * 1000
    keys.scene(root=root, log_id=log_id, scene_id=scene_id)
    longest = keys.selected(root=root, selection=name, log_id=log_id, scene_id=scene_id)
    assert len(longest) <= MAX_KEY_BYTES
    with pytest.raises(keys.KeyTooLongError, match="65535"):
        keys.scene(root=root, log_id=log_id, scene_id=scene_id * 3)


def test_a_sentence_and_a_name_that_a_log_gives_itself_are_cut_not_refused() -> None:
    said = TypeAdapter(Text).validate_python("x" * 100_000 + "\0")
    assert len(said) == MAX_TEXT
    plan = LogPlan(log_id="a", vehicle="v" * 1000, refused="why \0" * 2000)
    assert (len(plan.vehicle), len(plan.refused)) == (MAX_NAME, MAX_TEXT)


def test_what_a_worker_asks_is_in_the_table_of_verbs() -> None:
    assert set(get_args(Verb)) < set(VERBS)
    assert VERBS["about"].reply is AboutReply


def test_the_largest_honest_commit_is_within_the_bounds() -> None:
    """An hour of scenes of two seconds, every record as long as may be, all sent once more."""
    longest = '"' * MAX_RECORD_BYTES  # each of them is two bytes in a message
    scenes = 1800
    manifest = tuple(
        ManifestEntry(scene_id="s" * MAX_SCENE_ID, sha256="0" * 64) for _ in range(scenes)
    )
    commit = CommitRequest(
        worker_id="w" * MAX_NAME,
        lease_id="l" * 32,
        manifest=manifest,
        records=(longest,) * scenes,
    )
    assert len(encode(commit)) < MAX_COMMIT_BYTES == VERBS["commit"].most_bytes
    assert scenes < MAX_SCENES_OF_A_SHARD
    with pytest.raises(ValidationError, match="at most 16896"):
        commit.model_validate({**commit.model_dump(), "records": ("é" * MAX_RECORD_BYTES,)})
