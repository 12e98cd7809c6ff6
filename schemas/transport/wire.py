"""Encoding of messages on the bus: canonical JSON, so that equal records are equal bytes."""

from typing import Final, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from schemas.canonical import canonical_json
from schemas.errors import PermanentError
from schemas.score import MAX_RECORD_BYTES, SCHEMA_VERSION, SceneScore
from schemas.transport.affordable import too_costly
from schemas.visible import visible

SCENE_SCORE_ENCODING: Final = ("application/json", f"counterpoint.scene_score.v{SCHEMA_VERSION}")
"""Zenoh encoding and schema suffix of a scored scene."""

SCENE_SCORE_V1_ENCODING: Final = ("application/json", "counterpoint.scene_score.v1")
"""The same of a scene that an earlier service stored: its bytes are never rewritten, because its
digest names its overlay."""

_VERSION_1: Final = b'"schema_version":1,'
"""Part of every record of version 1; in canonical JSON no text can contain its quotes."""

RANKED_SCENE_ENCODING: Final = ("application/json", "counterpoint.ranked_scene.v1")
"""Zenoh encoding and schema suffix of one scene of a selection."""

MOST_OF_A_PROBLEM: Final = 500
"""Characters of the description of an invalid message at most."""

Message = TypeVar("Message", bound=BaseModel)


def encode(message: BaseModel) -> bytes:
    """Encode any message of `schemas` canonically."""
    return canonical_json(message.model_dump(mode="json"))


def decode(kind: type[Message], payload: bytes) -> Message:
    """Decode and validate a message, which anyone may have sent.

    Raises:
        pydantic.ValidationError: If it is not a message of this kind, or would cost too much memory
            to decode.
    """
    if problem := too_costly(kind, payload):
        error = PydanticCustomError("too_costly", "{problem}", {"problem": problem})
        details = InitErrorDetails(type=error, input=None)
        raise ValidationError.from_exception_data(kind.__name__, [details])
    return kind.model_validate_json(payload)


def decode_reply(kind: type[Message], payload: bytes, *, to: str) -> Message:
    """Decode and validate what a service answers to a verb.

    Raises:
        PermanentError: If it is not a message of this kind.
    """
    try:
        return decode(kind, payload)
    except ValidationError as error:
        raise PermanentError(
            f"the service's answer to {to} cannot be read; are both sides of the same version? "
            f"({first_problem(error)})"
        ) from None


def first_problem(error: ValidationError) -> str:
    """Describe in one line of printable characters the first invalid field of a message."""
    first = error.errors(include_url=False, include_input=False)[0]
    place = ".".join(map(str, first["loc"])) or "payload"
    return visible(f"{place}: {first['msg']}", limit=MOST_OF_A_PROBLEM)


def is_of_version_1(record: bytes) -> bool:
    """Return whether an encoded scene was written as version 1."""
    return _VERSION_1 in record


def encode_scene_score(score: SceneScore) -> bytes:
    """Encode a scored scene for publishing, storage and comparison.

    Raises:
        ValueError: If it is larger than a message on the bus may be.
    """
    payload = encode(score)
    if len(payload) > MAX_RECORD_BYTES:
        raise ValueError(
            f"scene record of {len(payload)} bytes exceeds {MAX_RECORD_BYTES} ({score.scene_id})"
        )
    return payload
