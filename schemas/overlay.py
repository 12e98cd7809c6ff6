"""Overlay of a scene: every point with the labels of both streams, too large for the bus.

A record gives the amount of contradiction, the overlay shows the points. A reviewer's page and
`counterpoint show` draw from it alone, without the log and without the workers.
"""

import hashlib
import re
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Agreements, Labels, Mask, Points, check_array, freeze
from schemas.overlay_picture import MAX_PICTURES, Picture
from schemas.task import MOTION, Task

NO_POSITION_CM: Final = -32768
"""Value of all three coordinates of a point without a return, or farther than 327 m."""

MAX_CLASSES: Final = 255
"""Semantic classes of an overlay at most; one byte names the class of a point."""

MAX_NAME_BYTES: Final = 255
"""Bytes of one name in the file systems of Linux, macOS and Windows."""

MAX_FILE_BYTES: Final = 250
"""Bytes of an overlay's name; obstore first writes it under a name that is some bytes longer."""

MAX_KEY_BYTES: Final = 1024
"""Bytes of a key in S3, Google's and Azure's stores."""

_DIGEST_DIGITS: Final = 32
_PARTLY_ENCODED: Final = re.compile("%[0-9A-F]?$")

_PER_POINT: Final = {
    "semantic_labels": np.uint8,
    "predictive_labels": np.uint8,
    "witness_labels": np.uint8,
    "ground_mask": np.bool_,
    "class_id": np.int16,
    "semantic_confidence": np.uint8,
    "predictive_confidence": np.uint8,
    "instance_index": np.int32,
}


@dataclass(frozen=True, slots=True, eq=False)
class OverlayLidar:
    """A further lidar of a scene, whose points follow those of the main one in each frame.

    With F frames:

    Attributes:
        topic: Topic of its clouds.
        points: (F,) number of its points; 0 where it was silent.
        stamps_ns: (F,) stamps of its clouds, nanoseconds since the Unix epoch; 0 where silent.
        main_from_lidar: (F, 4, 4) its space to the sensor space of the frame, with the motion of
            the car between the two sweeps.
    """

    topic: str
    points: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    main_from_lidar: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check that the arrays fit each other, and make them read-only."""
        frames = len(self.points)
        check_array("points", self.points, shape=(frames,), dtype=np.int64)
        check_array("stamps_ns", self.stamps_ns, shape=(frames,), dtype=np.int64)
        check_array("main_from_lidar", self.main_from_lidar, shape=(frames, 4, 4), dtype="f8")
        freeze(self.points, self.stamps_ns, self.main_from_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """All points of a scene, frame after frame in their own order, and its instances.

    With P points in F frames and I instances:

    Attributes:
        scene_id: The scene it shows.
        stamps_ns: (F,) nanoseconds since the Unix epoch.
        offsets: (F + 1,) frame f has points offsets[f] to offsets[f + 1].
        points_cm: (P, 3) sensor space of each frame, centimetres; `NO_POSITION_CM` where none.
        semantic_labels: (P,) labels of the supervised stream, of the task.
        predictive_labels: (P,) labels of the self-supervised stream, of the task.
        witness_labels: (P,) labels of the third witness, of the task; `unknown` also where none was
            queried.
        ground_mask: (P,) true where the self-supervised stream labels ground.
        class_id: (P,) semantic class as an index into `class_names`, -1 none.
        class_names: Classes of the supervised stream; may be empty.
        semantic_confidence: (P,) of the supervised stream, 255 is 1. Workers write steps of 17,
            since finer ones cost a byte per point and show nothing more.
        predictive_confidence: (P,) of the self-supervised stream, in the same units.
        instance_index: (P,) instance that a contradicting point belongs to, -1 none.
        odom_from_sensor: (F, 4, 4) poses.
        instance_frame: (I,) the frame of each instance.
        instance_kind: (I,) code of the outcome of its points.
        instance_track: (I,) track it belongs to, numbered as in the scene's record and beyond.
        instance_boxes: (I, 7) centre x, y, z, length, width, height in metres, yaw in radians, in
            the sensor space of its frame.
        task: The task of both streams.
        lidars: Further lidars, in the order of their points; empty where one lidar was mined.
        pictures: Camera images that were kept, by frame and topic.
        scoring_inputs: Track features and scene facts from which the score is computed again, as
            `workers.contradiction.scoring_inputs` encodes them; empty in overlays without them.
        agreements: (P,) codes of the task's outcomes, from the labels of both streams.

    Raises:
        ValueError: If an array has the wrong shape or type, or does not fit the others.
    """

    scene_id: str
    stamps_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]
    points_cm: NDArray[np.int16]
    semantic_labels: Labels
    predictive_labels: Labels
    witness_labels: Labels
    ground_mask: Mask
    class_id: NDArray[np.int16]
    class_names: tuple[str, ...]
    semantic_confidence: NDArray[np.uint8]
    predictive_confidence: NDArray[np.uint8]
    instance_index: NDArray[np.int32]
    odom_from_sensor: NDArray[np.float64]
    instance_frame: NDArray[np.int32]
    instance_kind: NDArray[np.uint8]
    instance_track: NDArray[np.int32]
    instance_boxes: NDArray[np.float32]
    task: Task = MOTION
    lidars: tuple[OverlayLidar, ...] = ()
    pictures: tuple[Picture, ...] = ()
    scoring_inputs: bytes = b""
    agreements: Agreements = field(init=False)

    def __post_init__(self) -> None:
        """Check that the arrays fit each other, and make them read-only."""
        frames, points, found = len(self.stamps_ns), len(self.points_cm), len(self.instance_frame)
        check_array("stamps_ns", self.stamps_ns, shape=(frames,), dtype=np.int64)
        check_array("offsets", self.offsets, shape=(frames + 1,), dtype=np.int64)
        check_array("points_cm", self.points_cm, shape=(None, 3), dtype=np.int16)
        for name, dtype in _PER_POINT.items():
            check_array(name, getattr(self, name), shape=(points,), dtype=dtype)
        check_array("odom_from_sensor", self.odom_from_sensor, shape=(frames, 4, 4), dtype="f8")
        check_array("instance_frame", self.instance_frame, shape=(found,), dtype=np.int32)
        check_array("instance_kind", self.instance_kind, shape=(found,), dtype=np.uint8)
        check_array("instance_track", self.instance_track, shape=(found,), dtype=np.int32)
        check_array("instance_boxes", self.instance_boxes, shape=(found, 7), dtype=np.float32)
        _check_range("offsets", np.diff(self.offsets), 0, points)
        if not frames or self.offsets[0] != 0 or self.offsets[-1] != points:
            raise ValueError(f"offsets must run from 0 to {points} over at least one frame")
        if len(self.class_names) > MAX_CLASSES:
            raise ValueError(f"an overlay has at most {MAX_CLASSES} classes")
        for name in ("semantic_labels", "predictive_labels", "witness_labels"):
            _check_range(name, getattr(self, name), 0, self.task.unknown)
        _check_range("class_id", self.class_id, -1, len(self.class_names) - 1)
        _check_range("instance_index", self.instance_index, -1, found - 1)
        _check_range("instance_frame", self.instance_frame, 0, frames - 1)
        _check_range("instance_kind", self.instance_kind, 0, self.task.not_compared - 1)
        for lidar in self.lidars:
            check_array("points of a lidar", lidar.points, shape=(frames,), dtype=np.int64)
        if self.lidars:
            _check_range("points of the main lidar", self.main_points, 0, points)
        if len(self.pictures) > MAX_PICTURES:
            raise ValueError(f"an overlay has at most {MAX_PICTURES} pictures")
        _check_range(
            "frames of pictures", np.array([p.frame for p in self.pictures]), 0, frames - 1
        )
        told = agreements_of(self.semantic_labels, self.predictive_labels, self.task)
        object.__setattr__(self, "agreements", told)
        freeze(told, *(getattr(self, name) for name in _ARRAYS))

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.stamps_ns)

    @property
    def main_points(self) -> NDArray[np.int64]:
        """(F,) number of points of the main lidar, which come first in each frame."""
        further = [lidar.points for lidar in self.lidars]
        return np.diff(self.offsets) - np.sum(further, axis=0, dtype=np.int64)

    def points_of(self, frame: int) -> slice:
        """Return the slice of a frame's points in the arrays that have one entry per point."""
        return slice(int(self.offsets[frame]), int(self.offsets[frame + 1]))

    def points_m(self, frame: int) -> Points:
        """Return the (N, 3) points of a frame, sensor space, metres; see `has_position`."""
        return self.points_cm[self.points_of(frame)].astype(np.float32) / np.float32(100)

    def has_position(self, frame: int) -> Mask:
        """Return (N,) true for points of a frame with a return within range of the coordinates."""
        return np.asarray(self.points_cm[self.points_of(frame), 0] != NO_POSITION_CM)

    def instances_of(self, frame: int) -> NDArray[np.int64]:
        """Return the indices of the instances found in a frame."""
        return np.flatnonzero(self.instance_frame == frame)


_ARRAYS: Final = (
    "stamps_ns",
    "offsets",
    "points_cm",
    *_PER_POINT,
    "odom_from_sensor",
    "instance_frame",
    "instance_kind",
    "instance_track",
    "instance_boxes",
)


def agreements_of(semantic: Labels, predictive: Labels, task: Task) -> Agreements:
    """Return the agreement of each pair of labels; `not_compared` where either is `unknown`."""
    unknown = (semantic >= task.unknown) | (predictive >= task.unknown)
    codes = predictive * np.uint8(len(task.classes)) + semantic
    codes[unknown] = task.not_compared
    return codes


def labels_from_agreements(agreements: Agreements, task: Task = MOTION) -> tuple[Labels, Labels]:
    """Return the labels of the supervised and of the self-supervised stream, per point.

    Where the streams were not compared both are `unknown`, because an agreement does not keep the
    label of the one that labelled.
    """
    classes = np.uint8(len(task.classes))
    told = agreements < task.not_compared
    semantic = np.where(told, agreements % classes, np.uint8(task.unknown))
    predictive = np.where(told, agreements // classes, np.uint8(task.unknown))
    return semantic, predictive


def overlay_key(*, log_id: str, scene_id: str, pipeline_version: str, sha256: str) -> str:
    """Return the object key of a scene's overlay in the artifacts bucket.

    The key contains the digest of the scene's record. A log that is replaced has other scenes under
    the same ids, and the earlier ones return if its bytes do.

    Folders follow the log's key, each percent-encoded, since one file name of a long key would
    exceed the limit of file systems. `@` is always encoded in a part, so no log can lie in
    another's folder. A part that is itself too long for a file name is cut, with a digest of it at
    the end; so are the log's folders together where the whole would be too long for a key.
    """
    end = f"-{sha256[:16]}.overlay"
    *folders, last = (_part(part) for part in scene_id.removeprefix(f"{log_id}/").split("/"))
    scene = [_fitting(folder, MAX_NAME_BYTES) for folder in folders]
    scene.append(_fitting(last, MAX_FILE_BYTES - len(end)) + end)
    log = [_part(part) for part in log_id.split("/")]
    begin, fitting = (
        f"overlays/{_part(pipeline_version)}",
        [_fitting(p, MAX_NAME_BYTES) for p in log],
    )
    key = "/".join((begin, *fitting, "@", *scene))
    if len(key) <= MAX_KEY_BYTES:
        return key
    return "/".join((begin, _cut("~".join(log), MAX_NAME_BYTES), "@", *scene))


def _part(text: str) -> str:
    quoted = quote(text, safe="-_.")
    return quoted if quoted.strip(".") else quoted.replace(".", "%2E") or "%"


def _fitting(quoted: str, limit: int) -> str:
    return quoted if len(quoted) <= limit else _cut(quoted, limit)


def _cut(quoted: str, limit: int) -> str:
    """Cut a name, and append a digest of all of it behind an `@`, which no part contains itself."""
    digest = hashlib.sha256(quoted.encode()).hexdigest()[:_DIGEST_DIGITS]
    begin = _PARTLY_ENCODED.sub("", quoted[: limit - 1 - _DIGEST_DIGITS])
    return f"{begin}@{digest}"


def _check_range(name: str, values: NDArray[Any], low: int, high: int) -> None:
    if len(values) and (values.min() < low or values.max() > high):
        raise ValueError(
            f"{name} must lie in {low} to {high}, got {values.min()} to {values.max()}"
        )
