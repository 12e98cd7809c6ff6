"""Overlay of a scene that was scored again: other tracks and inputs, the same points."""

import json
from collections.abc import Sequence
from typing import Any

from schemas.transport.overlay_codec import laid_out
from schemas.transport.overlay_file import OverlayFile


def encode_rescored(
    file: OverlayFile, *, scene_id: str, instance_track: Sequence[int], scoring_inputs: bytes
) -> bytes:
    """Encode an overlay again with other tracks and inputs; its blocks of points are copied.

    Kept pictures stay, and name the tracks that they show by their new numbers.

    Args:
        file: The overlay before.
        scene_id: The scene that it shows from now on.
        instance_track: Number of the track of each instance, -1 without one.
        scoring_inputs: Inputs of the score.

    Returns:
        The bytes that `encode_overlay` gives for the same scene with these tracks and inputs.

    Raises:
        PackUnreadableError: If a block is damaged.
        ValueError: If the overlay has another number of instances.
    """
    facts: dict[str, Any] = json.loads(file.header_json)
    before: list[int] = facts["instances"]["track"]
    number_of = dict(zip(before, instance_track, strict=True))
    facts["scene_id"] = scene_id
    facts["instances"]["track"] = list(instance_track)
    for picture in facts["pictures"]:
        picture["tracks"] = sorted(number_of.get(track, track) for track in picture["tracks"])
    return laid_out(
        facts,
        views=[file.view(frame) for frame in range(len(file.header.frames))],
        rests=[file.rest(frame) for frame in range(len(file.header.frames))],
        pictures=[file.picture(number) for number in range(len(file.header.pictures))],
        scoring_inputs=scoring_inputs,
    )
