"""Boxes of one message in the space that it names, whichever type the message has."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from schemas.arrays import NS_PER_S
from schemas.predicted_boxes import MAX_BOXES, SCHEMA_NAME, PredictedBoxes
from schemas.visible import visible
from workers.ingest.boxes.definition import DefinitionUnreadableError
from workers.ingest.boxes.kinds import DETECTIONS, SCENE_UPDATE, box_kind, members_of
from workers.ingest.boxes.ros_values import read_ros
from workers.ingest.boxes.scene_update import scene_boxes
from workers.ingest.decoding import NOT_DECODED, MessageUnreadableError
from workers.ingest.message_size import too_much_to_decode
from workers.ingest.messages import MAX_TIME_NS, RawMessage
from workers.ingest.transforms import rigid

MAX_SIZE_M: Final = 60.0
"""Largest side of a box, metres; the longest trams have 55."""

MAX_PLACE_M: Final = 1e7
"""Largest coordinate of a centre, metres: a map in UTM coordinates has 6e6."""

MAX_TEXT_OF_A_BOX: Final = 64
"""Characters of a class or of an identity."""

AUTOWARE_CLASSES: Final = (
    "unknown",
    "car",
    "truck",
    "bus",
    "trailer",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "animal",
    "hazard",
    "over_drivable",
    "under_drivable",
)
"""Names of the labels of Autoware's `ObjectClassification`."""


@dataclass(slots=True)
class StatedBox:
    """One box as stated; `rotation` is (x, y, z, w), what is not stated is None or empty."""

    centre_m: Sequence[float]
    rotation: Sequence[float]
    size_m: Sequence[float]
    velocity_m_per_s: Sequence[float] | None = None
    velocity_in_box: bool = False
    score: float | None = None
    class_name: str = ""
    track_id: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class StatedBoxes:
    """Boxes of one message, those with impossible numbers left out.

    Attributes:
        stamp_ns: Their time.
        frame_id: Space of the arrays, by the log's own name; empty: that of the lidar.
        place: (B, 4, 4) poses in that space.
        size_m: (B, 3) length, width, height.
        velocity_m_per_s: (B, 3) over the ground along the axes of that space, NaN unknown.
        score: (B,) NaN unknown.
        class_name: Names, as stated.
        track_id: Identities, empty: none.
        not_finite: Boxes left out for numbers that are not finite.
        impossible_size: Boxes left out for a size of zero or beyond any vehicle.
        repeated_id: An identity that several boxes stated; they have none. Empty: none did.
    """

    stamp_ns: int
    frame_id: str
    place: NDArray[np.float64]
    size_m: NDArray[np.float64]
    velocity_m_per_s: NDArray[np.float64]
    score: NDArray[np.float64]
    class_name: tuple[str, ...]
    track_id: tuple[str, ...]
    not_finite: int = field(default=0)
    impossible_size: int = field(default=0)
    repeated_id: str = field(default="")


def stated_boxes(message: RawMessage) -> StatedBoxes:
    """Read a message of boxes.

    Raises:
        MessageUnreadableError: If it cannot be decoded, or has too many boxes.
    """
    channel = message.channel
    kind = box_kind(channel)
    problem = too_much_to_decode(channel, message.data) if kind else "it is no message of boxes"
    if problem or kind is None:
        raise _unreadable(message, problem)
    try:
        stamp_ns, frame_id, boxes = _READERS.get(kind.name, _autoware)(message, kind.name)
        if len(boxes) > MAX_BOXES:
            raise ValueError(f"it has {len(boxes)} boxes, more than {MAX_BOXES}")
        return gather(stamp_ns, frame_id, boxes)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the message"
        raise _unreadable(message, f"{where}: {first['msg']}") from error
    except DefinitionUnreadableError as error:
        raise _unreadable(message, f"its definition: {error}") from error
    except (*NOT_DECODED, AttributeError) as error:
        raise _unreadable(message, f"{type(error).__name__}: {error}") from error


def gather(stamp_ns: int, frame_id: str, boxes: Iterable[StatedBox]) -> StatedBoxes:
    """Make arrays of boxes, and count those that no object can have.

    Args:
        stamp_ns: Their time.
        frame_id: Their space.
        boxes: As stated.
    """
    kept: list[StatedBox] = []
    not_finite = impossible = 0
    for each in boxes:
        numbers = np.array([*each.centre_m, *each.rotation, *each.size_m], np.float64)
        if not np.isfinite(numbers).all() or np.abs(numbers[:3]).max() > MAX_PLACE_M:
            not_finite += 1
        elif numbers[7:].min() <= 0.0 or numbers[7:].max() > MAX_SIZE_M:
            impossible += 1
        else:
            kept.append(each)
    place = np.array(
        [rigid(tuple(map(float, b.centre_m)), tuple(map(float, b.rotation))) for b in kept]
    ).reshape(-1, 4, 4)
    stated = Counter(each.track_id for each in kept if each.track_id)
    repeated_id = next((name for name, count in stated.items() if count > 1), "")
    return StatedBoxes(
        stamp_ns=stamp_ns if 0 < stamp_ns <= MAX_TIME_NS else 0,
        frame_id=visible(frame_id, limit=MAX_TEXT_OF_A_BOX).strip("/"),
        place=place,
        size_m=np.array([each.size_m for each in kept], np.float64).reshape(-1, 3),
        velocity_m_per_s=np.array(
            [_velocity(each, place[i]) for i, each in enumerate(kept)], np.float64
        ).reshape(-1, 3),
        score=np.array([_score(each.score) for each in kept], np.float64),
        class_name=tuple(visible(each.class_name, limit=MAX_TEXT_OF_A_BOX) for each in kept),
        track_id=tuple(
            "" if stated[each.track_id] > 1 else each.track_id[:MAX_TEXT_OF_A_BOX] for each in kept
        ),
        not_finite=not_finite,
        impossible_size=impossible,
        repeated_id=visible(repeated_id, limit=MAX_TEXT_OF_A_BOX),
    )


def _velocity(box: StatedBox, place: NDArray[np.float64]) -> NDArray[np.float64]:
    if box.velocity_m_per_s is None:
        return np.full(3, np.nan)
    stated = np.array(box.velocity_m_per_s, np.float64)
    if not np.isfinite(stated).all():
        return np.full(3, np.nan)
    turned: NDArray[np.float64] = place[:3, :3] @ stated
    return turned if box.velocity_in_box else stated


def _score(stated: float | None) -> float:
    known = stated is not None and 0.0 <= stated <= 1.0
    return float(stated) if known and stated is not None else float("nan")


_Answer = tuple[int, str, list[StatedBox]]


def _ros(message: RawMessage, type_name: str) -> dict[str, Any]:
    channel = message.channel
    members = members_of(type_name, channel.schema_encoding, channel.schema_base64)
    cdr = channel.message_encoding == "cdr"
    return read_ros(message.data, members, cdr=cdr, most=MAX_BOXES)


def _xyz(of: Mapping[str, Any]) -> tuple[float, ...]:
    return tuple(float(of[axis]) for axis in "xyz")


def _xyzw(of: Mapping[str, Any]) -> tuple[float, ...]:
    return tuple(float(of[axis]) for axis in "xyzw")


def _detections(message: RawMessage, type_name: str) -> _Answer:
    decoded = _ros(message, type_name)
    header, boxes = decoded["header"], []
    for each in decoded["detections"]:
        own = each.get("header", header)
        if not header["frame_id"]:
            header = own  # some writers fill in the headers of the members alone
        results = [{**result, **result.get("hypothesis", {})} for result in each["results"]]
        best = max(results, key=lambda result: float(result["score"]), default={})
        named = best.get("class_id", best.get("id", ""))
        track_id = each.get("tracking_id") or each.get("id") or best.get("object_id") or ""
        centre = each["bbox"]["center"]
        boxes.append(
            StatedBox(
                centre_m=_xyz(centre["position"]),
                rotation=_xyzw(centre["orientation"]),
                size_m=_xyz(each["bbox"]["size"]),
                score=best.get("score"),
                class_name=str(named),
                track_id=str(track_id),
            )
        )
    return header["stamp"], header["frame_id"], boxes


def _autoware(message: RawMessage, type_name: str) -> _Answer:
    decoded, boxes = _ros(message, type_name), []
    for each in decoded["objects"]:
        kinematics = each["kinematics"]
        pose, twist = (
            kinematics.get(
                f"{what}_with_covariance", kinematics.get(f"initial_{what}_with_covariance")
            )
            for what in ("pose", "twist")
        )
        best: dict[str, Any] = max(
            each["classification"], key=lambda one: float(one["probability"]), default={}
        )
        label = int(best.get("label", 0))
        uuid = bytes(each["object_id"]["uuid"]).hex() if "object_id" in each else ""
        boxes.append(
            StatedBox(
                centre_m=_xyz(pose["pose"]["position"]),
                rotation=_xyzw(pose["pose"]["orientation"]),
                size_m=_xyz(each["shape"]["dimensions"]),
                velocity_m_per_s=_xyz(twist["twist"]["linear"])
                if kinematics.get("has_twist", True)
                else None,
                velocity_in_box=True,
                score=each["existence_probability"],
                class_name=AUTOWARE_CLASSES[label]
                if label < len(AUTOWARE_CLASSES)
                else f"class {label}",
                track_id=uuid if uuid.strip("0") else "",
            )
        )
    return decoded["header"]["stamp"], decoded["header"]["frame_id"], boxes


def _published(message: RawMessage, _: str) -> _Answer:
    decoded = PredictedBoxes.model_validate_json(bytes(message.data))
    boxes = [
        StatedBox(
            centre_m=each.centre_m,
            rotation=each.quaternion_xyzw
            or (0.0, 0.0, float(np.sin(each.yaw_rad / 2)), float(np.cos(each.yaw_rad / 2))),
            size_m=each.size_m,
            velocity_m_per_s=each.velocity_m_per_s,
            score=each.score,
            class_name=each.class_name,
            track_id=each.track_id,
        )
        for each in decoded.boxes
    ]
    return decoded.stamp_ns, decoded.frame_id, boxes


def _scene_update(message: RawMessage, _: str) -> _Answer:
    stamp_ns, frame_id, cubes = scene_boxes(message)
    return stamp_ns, frame_id, [StatedBox(**cube) for cube in cubes]


_READERS: Final[Mapping[str, Callable[[RawMessage, str], _Answer]]] = {
    DETECTIONS: _detections,
    SCHEMA_NAME: _published,
    SCENE_UPDATE: _scene_update,
}


def _unreadable(message: RawMessage, why: str) -> MessageUnreadableError:
    return MessageUnreadableError(
        f"cannot read boxes: {visible(why, limit=300)} ({message.channel.topic}, "
        f"{message.channel.schema_name}, logged at {message.log_time_ns / NS_PER_S:.3f} s)"
    )
