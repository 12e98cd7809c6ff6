"""What is kept of a mined scene: its record, and a digest of each array of its overlay."""

import hashlib
import json
from dataclasses import replace
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict

from schemas.overlay import Overlay
from schemas.score import Producers
from schemas.transport.overlay_codec import decode_overlay
from workers.contradiction.scoring_inputs import decode_inputs, encode_inputs
from workers.mine import MinedRecord

TEXTS: Final = frozenset(
    {"reasons", "reason", "supporting", "opposing", "neutral", "schema_version"}
)
"""Fields of a record, at any depth, that hold words for people."""

PRODUCERS: Final = "producers"

_NO_PRODUCERS: Final = Producers(supervised="", selfsupervised="", pipeline_version="none")
"""In place of those that the inputs of a score repeat."""

_STRICT = ConfigDict(frozen=True, extra="forbid")


class FrozenScene(BaseModel):
    """A mined scene.

    Attributes:
        scene_id: Of the scene.
        producers: Names and versions of what made it.
        texts: Words for people, by path in the record.
        values: Everything else in the record, by path in it.
        overlay: Digest of each array of the overlay, and of what is beside the arrays.
    """

    model_config = _STRICT

    scene_id: str
    producers: dict[str, Any]
    texts: dict[str, Any]
    values: dict[str, Any]
    overlay: dict[str, str]


class Yardstick(BaseModel):
    """All runs of one state of the project.

    Attributes:
        simulated_log: Digest of the simulated log's bytes.
        runs: Scenes by name of the run, in the order they were mined in.
    """

    model_config = _STRICT

    simulated_log: str
    runs: dict[str, tuple[FrozenScene, ...]]


def frozen_scene(mined: MinedRecord) -> FrozenScene:
    """Take a mined scene apart."""
    record: dict[str, Any] = json.loads(mined.record)
    producers = record.pop(PRODUCERS)
    values, texts = dict[str, Any](), dict[str, Any]()
    _flatten(record, "", values, texts)
    return FrozenScene(
        scene_id=mined.score.scene_id,
        producers=producers,
        texts=texts,
        values=values,
        overlay=_digests(decode_overlay(mined.overlay)),
    )


def digest_of(payload: bytes) -> str:
    """Return the sha256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(payload).hexdigest()


def _flatten(node: Any, path: str, values: dict[str, Any], texts: dict[str, Any]) -> None:
    entries = node.items() if isinstance(node, dict) else enumerate(node)
    for name, entry in entries:
        below = f"{path}.{name}" if path else str(name)
        if name in TEXTS:
            texts[below] = entry
        elif isinstance(entry, dict | list) and entry:
            _flatten(entry, below, values, texts)
        else:
            values[below] = entry


def _digests(overlay: Overlay) -> dict[str, str]:
    digests = {}
    for name in overlay.__slots__:
        part = getattr(overlay, name)
        if name == "scoring_inputs" and part:
            part = encode_inputs(replace(decode_inputs(part), producers=_NO_PRODUCERS))
        if isinstance(part, np.ndarray):
            part = f"{part.dtype.str} {part.shape} {digest_of(part.tobytes())}"
        digests[name] = digest_of(str(part).encode())
    return digests
