"""Boxes in a Foxglove `SceneUpdate`: the cubes of its entities, with what their metadata states."""

from typing import Any, Final

from schemas.arrays import NS_PER_S
from workers.ingest.decoding import decode_message
from workers.ingest.messages import RawMessage
from workers.ingest.transforms import member

CLASS_KEYS: Final = ("class", "class_name", "label", "category", "type", "classification")
SCORE_KEYS: Final = ("score", "confidence", "probability")
SPEED_KEYS: Final = (("vx", "vy", "vz"), ("velocity_x", "velocity_y", "velocity_z"))
"""Keys of metadata, in lower case, that converters write; the first in an entity counts."""


def scene_boxes(message: RawMessage) -> tuple[int, str, list[dict[str, Any]]]:
    """Read the cubes of an update.

    Every update counts as one whole answer. Entities of other frames or times than the first are
    an error, since an answer has one of each.

    Returns:
        Stamp in nanoseconds, frame, and the arguments of a `StatedBox` for each cube.

    Raises:
        ValueError: If the entities have several frames.
        MessageUnreadableError: If the message cannot be decoded.
    """
    decoded = decode_message(message)
    entities = list(_get(decoded, "entities") or ())
    frames = {str(_get(each, "frame_id") or "") for each in entities}
    if len(frames) > 1:
        raise ValueError(f"its entities are in {len(frames)} frames, one is read")
    boxes = [
        _box(cube, entity, alone=len(cubes) == 1)
        for entity in entities
        for cubes in [list(_get(entity, "cubes") or ())]
        for cube in cubes
    ]
    stamp_ns = _stamp_ns(_get(entities[0], "timestamp")) if entities else message.log_time_ns
    return stamp_ns, next(iter(frames), ""), boxes


def _box(cube: Any, entity: Any, *, alone: bool) -> dict[str, Any]:
    pose, size = _get(cube, "pose"), _get(cube, "size")
    position, orientation = _get(pose, "position"), _get(pose, "orientation")
    told = {
        str(member(pair, "key")).lower(): str(member(pair, "value"))
        for pair in _get(entity, "metadata") or ()
    }
    speeds = [[_number(told.get(key)) for key in keys] for keys in SPEED_KEYS]
    velocity = next(
        ((x, y, z or 0.0) for x, y, z in speeds if x is not None and y is not None), None
    )
    return {
        "centre_m": [_get(position, axis) or 0.0 for axis in "xyz"],
        "rotation": [_get(orientation, axis) or 0.0 for axis in "xyzw"],
        "size_m": [_get(size, axis) or 0.0 for axis in "xyz"],
        "velocity_m_per_s": velocity,
        "score": next((_number(told[key]) for key in SCORE_KEYS if key in told), None),
        "class_name": next((told[key] for key in CLASS_KEYS if key in told), ""),
        "track_id": str(_get(entity, "id") or "") if alone else "",
    }


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _get(of: Any, name: str) -> Any:
    """Read a field of a protobuf message or of JSON; None where it is absent."""
    if of is None:
        return None
    return of.get(name) if isinstance(of, dict) else getattr(of, name, None)


def _stamp_ns(stamp: Any) -> int:
    if stamp is None:
        return 0
    if isinstance(stamp, dict):
        return int(stamp.get("sec", 0)) * NS_PER_S + int(stamp.get("nsec", 0))
    return int(stamp.seconds) * NS_PER_S + int(stamp.nanos)
