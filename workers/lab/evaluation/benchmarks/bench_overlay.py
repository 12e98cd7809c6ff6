"""Overlay bench: bytes and times of version 2 and of version 1, and the score computed again."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.mining import MiningSettings
from schemas.overlay import Overlay
from schemas.task import MOTION
from schemas.transport.array_pack import pack
from schemas.transport.bucket import Bucket
from schemas.transport.overlay_blocks import to_planes
from schemas.transport.overlay_codec import decode_overlay, encode_overlay, overlay_file_of
from schemas.transport.overlay_version_1 import VERSION_1_MAGIC
from schemas.transport.wire import encode_scene_score
from schemas.work import Recording
from workers.contradiction.rescoring import rescored
from workers.contradiction.scoring_inputs import decode_inputs
from workers.lab.evaluation.benchmarks.lower_bounds import MS_PER_S
from workers.mine import MinedRecord
from workers.score import score_recording

ROUNDS: Final = 3
"""Runs of each step; the fastest counts."""

_IN_VERSION_1: Final = (
    "stamps_ns",
    "offsets",
    "agreements",
    "class_id",
    "semantic_confidence",
    "predictive_confidence",
    "odom_from_sensor",
    "instance_frame",
    "instance_kind",
    "instance_track",
    "instance_boxes",
)
"""Arrays that version 1 stores unchanged."""

Result = TypeVar("Result")


class OverlayFigures(BaseModel):
    """Figures of the overlay of one scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scene: str
    frames: int
    points: int = Field(description="Per frame, mean.")
    version_1_bytes: int
    bytes: int = Field(description="Of version 2, without pictures.")
    ratio: float = Field(description="Version 2 without pictures over version 1.")
    pictures: int
    picture_bytes: int
    inputs_bytes: int = Field(description="Block of the score's inputs.")
    view_bytes: int = Field(description="Largest view block of a frame.")
    encoding_1_ms: float
    encoding_ms: float
    reading_1_ms: float
    reading_ms: float
    block_ms: float = Field(description="Header and one view block by byte range.")
    rescoring_ms: float
    is_rescored: bool = Field(description="The record was computed again, byte for byte.")


def bench_overlays(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, clock: Callable[[], float]
) -> Iterator[OverlayFigures]:
    """Mine a log, and measure the overlay of every scene.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        settings: Names of the parts, and ingest settings.
        clock: Seconds, of the wall or of the processor.

    Raises:
        LogUnusableError: If the log cannot be mined.
    """
    mined: list[MinedRecord] = []
    for _ in score_recording(bucket, recording, settings, on_scene=mined.append):
        yield _figures(mined.pop(), clock)


def encode_version_1(overlay: Overlay) -> bytes:
    """Encode an overlay as the program did before frames were blocks of their own."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(overlay, name) for name in _IN_VERSION_1}
    arrays["points_cm"] = to_planes(overlay.points_cm)
    arrays["ground_mask"] = np.packbits(overlay.ground_mask)
    at = np.flatnonzero(overlay.instance_index >= 0)
    arrays["instance_index"] = overlay.instance_index[at]
    arrays["instance_points"] = at
    meta: dict[str, Any] = {
        "scene_id": overlay.scene_id,
        "class_names": list(overlay.class_names),
    }
    if overlay.task is not MOTION:
        meta["task"] = overlay.task.name
    return pack(VERSION_1_MAGIC, meta, arrays)


def _figures(mined: MinedRecord, clock: Callable[[], float]) -> OverlayFigures:
    kept = decode_overlay(mined.overlay)
    overlay = replace(kept, pictures=())
    before, encoding_1_ms = _timed(lambda: encode_version_1(overlay), clock)
    payload, encoding_ms = _timed(lambda: encode_overlay(overlay), clock)
    _, reading_1_ms = _timed(lambda: decode_overlay(before), clock)
    _, reading_ms = _timed(lambda: decode_overlay(payload), clock)
    _, block_ms = _timed(lambda: overlay_file_of(payload).view(len(overlay) // 2), clock)
    again, rescoring_ms = _timed(lambda: rescored(decode_inputs(kept.scoring_inputs)), clock)
    header = overlay_file_of(payload).header
    return OverlayFigures(
        scene=overlay.scene_id,
        frames=len(overlay),
        points=len(overlay.points_cm) // len(overlay),
        version_1_bytes=len(before),
        bytes=len(payload),
        ratio=round(len(payload) / len(before), 4),
        pictures=len(kept.pictures),
        picture_bytes=sum(len(picture.image_bytes) for picture in kept.pictures),
        inputs_bytes=header.inputs[1],
        view_bytes=max(frame.view[1] for frame in header.frames),
        encoding_1_ms=encoding_1_ms,
        encoding_ms=encoding_ms,
        reading_1_ms=reading_1_ms,
        reading_ms=reading_ms,
        block_ms=block_ms,
        rescoring_ms=rescoring_ms,
        is_rescored=encode_scene_score(again) == mined.record,
    )


def _timed(step: Callable[[], Result], clock: Callable[[], float]) -> tuple[Result, float]:
    """Return the result of a step, and its milliseconds in the fastest of some runs."""
    took_ms: list[float] = []
    while True:
        began_s = clock()
        result = step()
        took_ms.append((clock() - began_s) * MS_PER_S)
        if len(took_ms) == ROUNDS:
            return result, round(min(took_ms), 2)
