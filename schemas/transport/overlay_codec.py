"""Binary codec of overlays; equal overlays give equal bytes."""

from collections.abc import Sequence
from typing import Any, Final
from zlib import crc32

import numpy as np

from schemas.overlay import Overlay
from schemas.task import UnknownTaskError, task_named
from schemas.transport.array_pack import MAX_UNPACKED_BYTES, PackUnreadableError
from schemas.transport.overlay_blocks import (
    VIEW_BYTES_A_POINT,
    compress,
    rest_block,
    rest_points,
    view_block,
    view_points,
)
from schemas.transport.overlay_facts import facts_of, lidar_of, picture_of
from schemas.transport.overlay_file import (
    OverlayFile,
    OverlayIsVersion1Error,
    OverlayUnusableError,
    open_overlay_file,
    unusable,
    version_of,
)
from schemas.transport.overlay_header import encoded_header
from schemas.transport.overlay_version_1 import decoded_version_1

MAX_OVERLAY_BYTES: Final = MAX_UNPACKED_BYTES
"""Maximum bytes of an overlay, encoded and decoded."""

_NOT_WELL_FORMED: Final = (
    KeyError,
    TypeError,
    ValueError,
    IndexError,
    OverflowError,
    UnknownTaskError,
)


def encode_overlay(overlay: Overlay) -> bytes:
    """Encode an overlay; equal overlays give equal bytes.

    Raises:
        ValueError: If it would be larger than any overlay.
    """
    return laid_out(
        facts_of(overlay),
        views=[view_block(overlay, frame) for frame in range(len(overlay))],
        rests=[rest_block(overlay, frame) for frame in range(len(overlay))],
        pictures=[picture.image_bytes for picture in overlay.pictures],
        scoring_inputs=overlay.scoring_inputs,
    )


def laid_out(
    facts: dict[str, Any],
    *,
    views: Sequence[bytes],
    rests: Sequence[bytes],
    pictures: Sequence[bytes],
    scoring_inputs: bytes,
) -> bytes:
    """Lay out an overlay.

    Args:
        facts: Its header without the places of the blocks.
        views: View block of each frame.
        rests: Rest block of each frame.
        pictures: Image of each picture.
        scoring_inputs: Inputs of its score, uncompressed; empty: none.

    Raises:
        ValueError: If it would be larger than any overlay.
    """
    inputs = compress(scoring_inputs) if scoring_inputs else b""
    blocks = [*views, *rests, *pictures, inputs]
    ends = np.cumsum([len(block) for block in blocks])
    starts = [0, *ends.tolist()]
    if ends[-1] > MAX_OVERLAY_BYTES:
        raise ValueError(f"overlay of {ends[-1]} bytes exceeds {MAX_OVERLAY_BYTES}")
    places = [[start, len(block)] for start, block in zip(starts, blocks, strict=False)]
    crcs = [crc32(block) for block in blocks]

    def header_at(begin: int) -> dict[str, Any]:
        at = [[begin + start, length] for start, length in places]
        for number, entry in enumerate(facts["frames"]):
            rest = number + len(views)
            entry |= {"view": at[number], "view_crc32": crcs[number]}
            entry |= {"rest": at[rest], "rest_crc32": crcs[rest]}
        for number, entry in enumerate(facts["pictures"], start=2 * len(views)):
            entry |= {"block": at[number], "crc32": crcs[number]}
        return facts | {"inputs": at[-1], "inputs_crc32": crcs[-1]}

    return b"".join([encoded_header(header_at), *blocks])


def decode_overlay(payload: bytes, *, scene_id: str = "", where: str = "") -> Overlay:
    """Decode an overlay, of this version or an earlier one.

    Args:
        payload: As `encode_overlay` made it.
        scene_id: The scene that it must be of; empty: of any.
        where: URL or path that it was read from, for messages.

    Raises:
        PackUnreadableError: If the bytes are no overlay, damaged, larger than any overlay, of a
            newer version, or of another scene; the message names the place and what to do.
    """
    try:
        overlay = _decoded(payload, where)
    except OverlayUnusableError:
        raise
    except PackUnreadableError as error:
        raise unusable(error, where) from error
    if scene_id and overlay.scene_id != scene_id:
        raise unusable(f"is of scene {overlay.scene_id}, not of {scene_id}", where)
    return overlay


def overlay_file_of(payload: bytes, *, where: str = "") -> OverlayFile:
    """Open the bytes of an overlay for reading single blocks; one of version 1 is encoded again.

    Raises:
        PackUnreadableError: If they are no overlay, damaged, or of a newer version.
    """

    def read(offset: int, length: int) -> bytes:
        return payload[offset : offset + length]

    try:
        return open_overlay_file(read, file_bytes=len(payload), where=where)
    except OverlayIsVersion1Error:
        return overlay_file_of(encode_overlay(decode_overlay(payload, where=where)), where=where)


def _decoded(payload: bytes, where: str) -> Overlay:
    if len(payload) > MAX_OVERLAY_BYTES:
        raise PackUnreadableError(f"has {len(payload)} bytes, more than {MAX_OVERLAY_BYTES}")
    try:
        return (
            decoded_version_1(payload) if version_of(payload) == 1 else _version_2(payload, where)
        )
    except _NOT_WELL_FORMED as error:
        raise PackUnreadableError(f"not a well-formed overlay: {error}") from error


def _version_2(payload: bytes, where: str) -> Overlay:
    file = overlay_file_of(payload, where=where)
    header, frames = file.header, file.header.frames
    task = task_named(header.task)
    total = sum(frame.points for frame in frames)
    if total * VIEW_BYTES_A_POINT > MAX_OVERLAY_BYTES:
        raise PackUnreadableError(f"claims {total} points, more than any overlay has")
    views = [view_points(file.view(n), f.points, task.unknown) for n, f in enumerate(frames)]
    rests = [rest_points(file.rest(n), f.points) for n, f in enumerate(frames)]
    offsets = np.concatenate([[0], np.cumsum([f.points for f in frames])]).astype(np.int64)
    index = np.full(total, -1, dtype=np.int32)
    for begin, view in zip(offsets, views, strict=False):
        index[begin + view.instance_points] = view.instance_of
    semantic_confidence, predictive_confidence = np.concatenate(rests, axis=1)
    columns = header.instances
    return Overlay(
        scene_id=header.scene_id,
        stamps_ns=np.array([int(f.stamp_ns) for f in frames], dtype=np.int64),
        offsets=offsets,
        points_cm=np.concatenate([view.points_cm for view in views]),
        semantic_labels=np.concatenate([view.semantic_labels for view in views]),
        predictive_labels=np.concatenate([view.predictive_labels for view in views]),
        witness_labels=np.concatenate([view.witness_labels for view in views]),
        ground_mask=np.concatenate([view.ground_mask for view in views]),
        class_id=np.concatenate([view.class_id for view in views]),
        class_names=tuple(header.class_names),
        semantic_confidence=semantic_confidence,
        predictive_confidence=predictive_confidence,
        instance_index=index,
        odom_from_sensor=np.array([f.odom_from_sensor for f in frames]).reshape(-1, 4, 4),
        instance_frame=np.array(columns.frame, dtype=np.int32),
        instance_kind=np.array(columns.kind, dtype=np.uint8),
        instance_track=np.array(columns.track, dtype=np.int32),
        instance_boxes=np.array(columns.boxes, dtype=np.float32).reshape(-1, 7),
        task=task,
        lidars=tuple(lidar_of(entry) for entry in header.lidars),
        pictures=tuple(
            picture_of(entry, file.picture(n)) for n, entry in enumerate(header.pictures)
        ),
        scoring_inputs=file.scoring_inputs(),
    )
