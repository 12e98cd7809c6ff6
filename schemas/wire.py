"""Bytes on the bus: canonical JSON, so that equal records are equal bytes."""

import hashlib
import json
from typing import Any, Final, TypeVar

from pydantic import BaseModel

from schemas.score import MAX_RECORD_BYTES, SceneScore

SCENE_SCORE_ENCODING: Final = ("application/json", "counterpoint.scene_score.v1")
"""Zenoh encoding and schema suffix of a scored scene."""

RANKED_SCENE_ENCODING: Final = ("application/json", "counterpoint.ranked_scene.v1")
"""The same of one scene of a selection."""

Message = TypeVar("Message", bound=BaseModel)


_CANONICAL: Final = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
)
"""Made once: `json.dumps` would make one for each message."""


def canonical_json(value: Any) -> bytes:
    """Encode plain data: sorted keys, no spaces, ASCII, NaN refused."""
    return _CANONICAL.encode(value).encode()


def encode(message: BaseModel) -> bytes:
    """Encode any message of `schemas` canonically."""
    return canonical_json(message.model_dump(mode="json"))


def decode(kind: type[Message], payload: bytes) -> Message:
    """Decode and validate a message.

    Raises:
        pydantic.ValidationError: If it is not a message of this kind.
    """
    return kind.model_validate_json(payload)


def encode_scene_score(score: SceneScore) -> bytes:
    """Encode a scored scene as it is published, stored and compared.

    Raises:
        ValueError: If it is larger than the bus should carry.
    """
    payload = encode(score)
    if len(payload) > MAX_RECORD_BYTES:
        raise ValueError(
            f"scene record of {len(payload)} bytes exceeds {MAX_RECORD_BYTES} ({score.scene_id})"
        )
    return payload


def sha256(payload: bytes) -> str:
    """Digest that manifests, the ledger and `counterpoint top` name a record by."""
    return hashlib.sha256(payload).hexdigest()
